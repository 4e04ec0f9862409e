"""A dataset's folder: read and checked, and written completely or not at all."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from skincal.bounded import MOST_ROWS
from skincal.covariates import NORMAL
from skincal.dataset import meta_file
from skincal.dataset.columns import repeated
from skincal.dataset.corrections import drop_impossible, with_converter_range
from skincal.dataset.dataset import Dataset
from skincal.dataset.findings import SHOWN, Findings, Sheet, listed
from skincal.dataset.plausibility import check_plausible, check_scale
from skincal.dataset.rest import (
    ACTIVE_COUNTS,
    REST_IN_DOUBT,
    active_taxels,
    active_threshold,
    rest_in_doubt,
    rest_levels,
)
from skincal.dataset.table_conversion import frames_from, presses_from
from skincal.dataset.table_file import MOST_ROWS_HELD, RawTable, find_table, read_table, write_table
from skincal.errors import InputError, Problem, first_of
from skincal.files import whole_folder

NO_TABLE = "Is this a dataset's folder? `skincal import` makes one from a table with other names and units."
NO_FOLDER = "Give the folder that holds dataset.toml."


@dataclass(frozen=True)
class Check:
    """Problems of a dataset's folder in the order of the files, and the dataset; None if there are errors."""

    errors: tuple[Problem, ...]
    warnings: tuple[Problem, ...]
    dataset: Dataset | None


def read_dataset(path: str | Path) -> Dataset:
    """Read and check a dataset's folder (contract ``skincal-dataset/1``).

    ``warnings`` of the dataset do not prevent its use.

    Raises:
        InputError: the folder has violations; ``problems`` holds all of them.
    """
    findings = Findings(Path(path))
    dataset = _read(Path(path), findings)
    findings.raise_errors()
    assert dataset is not None
    return dataset


def check_dataset(path: str | Path) -> Check:
    """Check a dataset's folder; return its problems instead of raising them."""
    findings = Findings(Path(path))
    dataset = None
    try:
        dataset = _read(Path(path), findings)
    except InputError as error:  # a column that cannot be read
        findings.errors.extend(error.problems)
    return Check(tuple(findings.errors), tuple(findings.warnings), None if findings.errors else dataset)


def _read(folder: Path, findings: Findings) -> Dataset | None:
    if not folder.is_dir():
        got = "a file" if folder.exists() else "no such folder"
        findings.error(str(folder), "a dataset's folder", got, NO_FOLDER)
        return None
    before = meta_file.file_states(folder, ())
    meta = meta_file.read_meta(folder, findings)
    if meta is None:
        return None
    named = [meta.surface.file, meta.indenter.file, meta.sensor.positions]
    before = meta_file.file_states(folder, named) | before
    meshes = meta_file.read_meshes(folder, meta_file.FILE, meta.surface, meta.indenter, findings)
    positions = meta_file.read_positions(folder, meta_file.FILE, meta.sensor, findings)
    described = not findings.errors
    press_table = _table(folder, "presses", findings)
    presses = None if press_table is None else presses_from(press_table, meta)
    frame_table = _table(folder, "frames", findings)
    frames = None if frame_table is None else frames_from(frame_table, meta, presses)
    if presses is None or press_table is None:
        return None
    if not described:
        check_scale(presses.position_m, press_table.sheet)
        return None
    dataset = Dataset(meta, presses, frames, positions, meshes, folder.resolve())
    if _check_model(dataset, findings):
        check_plausible(dataset, press_table.sheet, frame_table and frame_table.sheet)
    if findings.errors:
        return None
    dataset = with_converter_range(drop_impossible(dataset, press_table.sheet), press_table.sheet)
    add_remarks(dataset, press_table.sheet)
    sha256 = ""
    with suppress(OSError):
        sha256 = meta_file.hash_of(folder, named)
    if meta_file.file_states(folder, named) != before or not sha256:
        got = "one that changed while it was read"
        findings.error(str(folder), "a dataset that stays as it is", got, "Run again.")
        return None
    return replace(dataset, sha256=sha256, warnings=tuple(findings.warnings))


def _table(folder: Path, stem: str, findings: Findings) -> RawTable | None:
    path = find_table(folder, stem, findings)
    if path is None and stem == "presses":
        findings.error(str(folder), f"{stem}.csv or {stem}.parquet", "neither", NO_TABLE)
    most_rows = MOST_ROWS if stem == "frames" else MOST_ROWS_HELD
    return None if path is None else read_table(path, findings, most_rows=most_rows)


def _check_model(dataset: Dataset, findings: Findings) -> bool:
    """Return whether the model can be built from the description; report the reason if not."""
    sensor = (
        f"{meta_file.FILE}, [sensor]" if dataset.positions is None else str(dataset.meta.sensor.positions)
    )
    place, expected = sensor, "a layout of taxels"
    try:
        centres_m = dataset.layout().centres_m
        place, expected = f"{meta_file.FILE}, [surface]", "a surface"
        surface = dataset.surface()
        place, expected = f"{meta_file.FILE}, [indenter]", "an indenter"
        dataset.indenter()
        place, expected = f"{meta_file.FILE}, [mount]", "a pose on the surface"
        points, _ = surface.wrap(dataset.nominal_pose(), centres_m)
    except ValueError as error:
        findings.error(place, expected, error)
        return False
    if outside := int(np.sum(~np.isfinite(points).all(axis=1))):
        got = f"{outside} taxels beyond the surface; compare the patch's size with the surface's"
        findings.error(place, expected, got)
    return not outside


Format = Literal["csv", "parquet"]


def write_dataset(
    dataset: Dataset,
    path: str | Path,
    *,
    presses_as: Format = "csv",
    frames_as: Format = "parquet",
    force: bool = False,
) -> None:
    """Write a dataset as a folder (contract ``skincal-dataset/1``); numbers are read back exactly.

    Raises:
        InputError: the folder exists, and ``force`` is false.
        OSError: the disk is full or not writable; no partial folder is left behind.
    """
    with whole_folder(path, force=force, marker=meta_file.FILE) as folder:
        write_dataset_files(dataset, folder, presses_as=presses_as, frames_as=frames_as)


def write_dataset_files(
    dataset: Dataset, folder: Path, *, presses_as: Format = "csv", frames_as: Format = "parquet"
) -> None:
    """Write the files of a dataset into an existing folder."""
    meta_file.write_meta(dataset.meta, folder / meta_file.FILE)
    taxels = dataset.meta.sensor.taxel_columns()
    write_table(folder / f"presses.{presses_as}", dataset.presses.to_columns(taxels))
    if dataset.frames is not None:
        write_table(folder / f"frames.{frames_as}", dataset.frames.to_columns(taxels))
    if dataset.positions is not None:
        columns = meta_file.position_columns(dataset.meta.sensor, dataset.positions)
        write_table(folder / str(dataset.meta.sensor.positions), columns)
    for name, content in dataset.meshes.items():
        (folder / name).write_bytes(content)


SLACK_SIGMAS = 50.0
"""Largest plausible slack, in sigmas: above it, one of the two is probably in another unit."""

FEWEST_ACTIVE = 1e-3
"""Smallest fraction of active readings that noise does not explain, if noise sets the threshold."""

STUCK_SHARE = 0.9
"""Largest fraction of presses at value_max; above it a taxel is reported as stuck."""


FEWEST_SIZES, MOST_LARGER = 8, 1.35
"""Smallest number of presses whose sizes are compared, and largest ratio of the 95 % to the 75 % quantile of sizes
under one force (set by eye: 1.0 to 1.2 under equal weights; 1.8 where forces differ by a factor of 6)."""


def add_remarks(dataset: Dataset, sheet: Sheet) -> None:
    """Add warnings to the findings of the sheet of presses."""
    _remark_on_activity(dataset, sheet)
    _remark_on_stuck(dataset, sheet)
    presses = dataset.presses
    # Noise makes two separate measurements differ.
    values = np.column_stack([presses.position_m, presses.force_n, presses.counts])
    fix = "Was a press copied? A fit uses one of them."
    sheet.bad_rows("press", repeated(values), presses.press, "different measurements", fix, warning=True)
    _remark_on_normals(dataset, sheet)
    _remark_on_slack(dataset, sheet.findings)
    _remark_on_constant_force(dataset, sheet)
    force = presses.force_n
    if (none := np.flatnonzero(force <= 0)).size:
        place, got = sheet.rows("force_n", none), listed(force[none[:SHOWN]].tolist(), none.size)
        sheet.findings.warn(place, "a positive normal force", got, "An outlier?", code="force_not_positive")


def _remark_on_constant_force(dataset: Dataset, sheet: Sheet) -> None:
    """Add a warning if images differ in size more than places alone explain, under an assumed constant force.

    Presses beside the patch are weak, but of those well on it, no image is much larger than the others.
    """
    presses = dataset.presses
    if "force_n" not in dataset.meta.assumed or len(presses) < FEWEST_SIZES or np.ptp(presses.force_n) > 0:
        return
    above = np.maximum(presses.counts - rest_levels(dataset), 0.0)
    usual, largest = np.quantile(np.nansum(above, axis=1), [0.75, 0.95])
    if largest > MOST_LARGER * usual > 0:
        sheet.findings.warn(
            sheet.column("force_n"), f"the same size of images under the constant force of {presses.force_n[0]:.3g} N",
            f"a twentieth that are {largest / usual:.2g} times as large as three quarters of them, or more",
            "The force was assumed, not measured. If it differed from press to press, E and S are wrong: map the "
            "measured force.", code="assumed_force",
        )  # fmt: skip


def _remark_on_activity(dataset: Dataset, sheet: Sheet) -> None:
    threshold = active_threshold(dataset)
    active = active_taxels(dataset, threshold)
    # Noise alone makes a taxel active occasionally.
    if threshold < ACTIVE_COUNTS and active.mean() < FEWEST_ACTIVE:
        active[:] = False
    expected = f"taxels more than {threshold:.3g} {dataset.meta.sensor.unit_label} above their level at rest"
    if not active.any():
        why = f"{REST_IN_DOUBT}." if rest_in_doubt(dataset) else "Do the counts grow with load?"
        fix = f"Nothing can be fitted to such data. {why}"
        sheet.findings.warn(sheet.file, expected, "none in any press", fix, code="nothing_to_fit")
    elif not np.any(active.sum(axis=1) >= 2):
        got, expected = "at most one in any press", f"two {expected} in a press"
        sheet.findings.warn(sheet.file, expected, got, "The fit needs two.")


def _remark_on_slack(dataset: Dataset, findings: Findings) -> None:
    sigma, slack = dataset.meta.position.sigma_m, dataset.meta.position.slack_m
    place, fix = "dataset.toml, [position]", "Twice sigma_m is a usual slack. Are both in metres?"
    if 0 < sigma < slack / SLACK_SIGMAS:
        findings.warn(f"{place} sigma_m", f"a good part of slack_m = {slack:g}", f"{sigma:g}", fix)
    if np.isfinite(sigma) and slack < sigma:
        findings.warn(f"{place} slack_m", f"more than sigma_m = {sigma:g}", f"{slack:g}", fix)


def _remark_on_stuck(dataset: Dataset, sheet: Sheet) -> None:
    top = dataset.meta.sensor.value_max
    if top is None or dataset.meta.sensor.baseline != "raw":
        return
    stuck = np.flatnonzero(np.mean(dataset.presses.counts >= top, axis=0) > STUCK_SHARE)
    if stuck.size:
        names = dataset.meta.sensor.taxel_columns()
        got = f"nearly always {top:g} from {first_of((names[j] for j in stuck), 6)}"
        sheet.findings.warn(sheet.file, f"counts below value_max = {top:g}", got, "Stuck?")


def _remark_on_normals(dataset: Dataset, sheet: Sheet) -> None:
    presses = dataset.presses
    if presses.normals is None or not np.isfinite(presses.position_m).all():
        return
    cosine = np.sum(presses.normals * dataset.surface().normal_at(presses.position_m), axis=1)
    expected = "a normal out of the fingertip (positive cosine with the surface's)"
    fix = "Is it the direction of the force instead?"
    sheet.bad_rows(", ".join(NORMAL), cosine < 0, cosine, expected, fix, warning=True)
