"""Read and check a dataset's folder."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from skincal.bounded import MOST_ROWS
from skincal.dataset.companions import read_meshes, read_positions
from skincal.dataset.converter_range import with_converter_range
from skincal.dataset.dataset import Dataset
from skincal.dataset.findings import Findings
from skincal.dataset.impossible import drop_impossible
from skincal.dataset.meta_file import FILE, file_states, hash_of, read_meta
from skincal.dataset.plausibility import check_plausible, check_scale
from skincal.dataset.remarks import add_remarks
from skincal.dataset.table_conversion import frames_from, presses_from
from skincal.dataset.table_file import MOST_ROWS_HELD, RawTable, find_table, read_table
from skincal.errors import InputError, Problem

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
    """Return the dataset of a folder; None, with errors added, if it cannot be used."""
    if not folder.is_dir():
        got = "a file" if folder.exists() else "no such folder"
        findings.error(str(folder), "a dataset's folder", got, NO_FOLDER)
        return None
    before = file_states(folder, ())
    meta = read_meta(folder, findings)
    if meta is None:
        return None
    named = [meta.surface.file, meta.indenter.file, meta.sensor.positions]
    before = file_states(folder, named) | before
    meshes = read_meshes(folder, FILE, meta.surface, meta.indenter, findings)
    positions = read_positions(folder, FILE, meta.sensor, findings)
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
        sha256 = hash_of(folder, named)
    if file_states(folder, named) != before or not sha256:
        got = "one that changed while it was read"
        findings.error(str(folder), "a dataset that stays as it is", got, "Run again.")
        return None
    return replace(dataset, sha256=sha256, warnings=tuple(findings.warnings))


def _table(folder: Path, stem: str, findings: Findings) -> RawTable | None:
    """Return the table of presses or frames; None without one, or with an error added."""
    path = find_table(folder, stem, findings)
    if path is None and stem == "presses":
        findings.error(str(folder), f"{stem}.csv or {stem}.parquet", "neither", NO_TABLE)
    most_rows = MOST_ROWS if stem == "frames" else MOST_ROWS_HELD
    return None if path is None else read_table(path, findings, most_rows=most_rows)


def _check_model(dataset: Dataset, findings: Findings) -> bool:
    """Return whether the model can be built from the description; report the reason if not."""
    sensor = f"{FILE}, [sensor]" if dataset.positions is None else str(dataset.meta.sensor.positions)
    for place, expected, make in (
        (sensor, "a layout of taxels", dataset.layout),
        (f"{FILE}, [surface]", "a surface", dataset.surface),
        (f"{FILE}, [indenter]", "an indenter", dataset.indenter),
    ):
        try:
            make()
        except ValueError as error:
            findings.error(place, expected, error)
            return False
    place, expected = f"{FILE}, [mount]", "a pose on the surface"
    try:
        points, _ = dataset.surface().wrap(dataset.nominal_pose(), dataset.layout().centres_m)
    except ValueError as error:
        findings.error(place, expected, error)
        return False
    if outside := int(np.sum(~np.isfinite(points).all(axis=1))):
        got = f"{outside} taxels beyond the surface; compare the patch's size with the surface's"
        findings.error(place, expected, got)
    return not outside
