"""A calibration as a folder: reading reports every fault, writing is complete or not at all."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import tomli_w
from numpy.typing import NDArray

from skincal.calibration.calibration import Calibration, Columns
from skincal.calibration.toml_file import FILE, FORMAT, CalibrationFile, plain_file
from skincal.covariates import ANY, NOT_NEGATIVE
from skincal.dataset.columns import ColumnReader
from skincal.dataset.findings import Findings, Sheet
from skincal.dataset.meta_file import position_columns, read_meshes, read_positions
from skincal.dataset.schema import load_toml, read_table
from skincal.dataset.table_file import RawTable, write_table
from skincal.dataset.table_file import read_table as read_raw_table
from skincal.effects import EFFECTS
from skincal.errors import readable
from skincal.files import real, whole_folder


def read_calibration(path: str | Path) -> Calibration:
    """Read and check a calibration's folder (contract ``skincal-calibration/1``).

    Args:
        path: the folder, or the ``calibration.toml`` in it. Grid, slack and draws may be missing.

    Returns:
        The calibration; its ``warnings`` do not forbid its use.

    Raises:
        InputError: the folder has violations; ``problems`` holds all of them, with file and key.
    """
    folder = Path(path)
    if folder.name == FILE and folder.is_file():
        folder = folder.parent
    findings = Findings(folder)
    if not folder.is_dir():
        got = "a file" if folder.exists() else "no such folder"
        findings.error(str(folder), "a calibration's folder", got)
    findings.raise_errors()
    values = load_toml(folder / FILE, findings, what="calibration", within=folder)
    found = None if values is None else read_table(CalibrationFile, values, findings, FILE, FORMAT)
    tables = read_tables(folder, findings)
    if found is None:
        findings.raise_errors()
        raise AssertionError("a file that is missing or no TOML is an error")
    found.warn(findings)
    meshes = read_meshes(folder, FILE, found.surface, found.indenter, findings)
    positions = read_positions(folder, FILE, found.sensor, findings)
    findings.raise_errors()
    content: dict[str, Any] = {**found.parts(), **tables}
    return Calibration(
        **content, positions=positions, meshes=meshes, warnings=tuple(findings.warnings), folder=real(folder)
    )


def write_calibration(
    calibration: Calibration,
    path: str | Path,
    *,
    force: bool = False,
    beside: Callable[[Path], None] | None = None,
) -> None:
    """Write a calibration as a folder (contract ``skincal-calibration/1``); numbers are read back exactly.

    Args:
        calibration: the calibration. It is checked like a file, so that it can be read back.
        path: folder to create.
        force: whether to replace an existing calibration.
        beside: writes further files (the report) into the given folder, before that is moved to
            its place.

    Raises:
        InputError: the folder exists and ``force`` is not given, or the calibration is invalid.
        OSError: the disk is full, or not writable; then nothing is left behind.
    """
    plain = plain_file(calibration)
    given = {name: getattr(calibration, name) for name in TABLE_FILES}
    tables = {name: columns for name, columns in given.items() if columns is not None}
    findings = Findings()
    read_table(CalibrationFile, plain, findings, FILE, FORMAT)
    check_tables(tables, findings)
    findings.raise_errors()
    with whole_folder(path, force=force, marker=FILE) as folder:
        (folder / FILE).write_bytes(readable(tomli_w.dumps(plain)).encode())
        for name, columns in tables.items():
            write_table(folder / TABLE_FILES[name], columns)
        if calibration.positions is not None:
            columns = position_columns(calibration.sensor, calibration.positions)
            write_table(folder / str(calibration.sensor.positions), columns)
        for name, content in calibration.meshes.items():
            (folder / name).write_bytes(content)
        if beside is not None:
            beside(folder)


TABLE_FILES: Final = {"grid": "grid.parquet", "slack": "slack.csv", "draws": "draws.parquet"}
"""File of each table."""

SLACK_COLUMNS: Final = {
    "press": "number of the press, as in the dataset",
    "used": "whether the fit used it",
    "reason": "reason if it did not; else empty",
    "x_m": "estimated contact point, fingertip frame [m]; with y_m, z_m; NaN where the press was not used",
    "y_m": "see x_m",
    "z_m": "see x_m",
    "slack_across_m": "estimated minus measured contact point, arc towards growing beta (on a plane +x) [m]",
    "slack_along_m": "estimated minus measured contact point, along +y [m]",
    "residual_rms_counts": "root mean square of the residual over the taxels [counts]",
    "good": "whether the press fits; look at the others",
}
"""Columns of ``slack.csv``, one row per press; a fit may add others."""

PARAMETERS: Final = ("y_m", "beta_deg", "x_m", "alpha_deg", "elasticity_pa_per_m", "scale_per_n")
"""Columns that ``draws.parquet`` may have, in addition to ``effects.NAME.PARAMETER``."""


def read_tables(folder: Path, findings: Findings) -> dict[str, Columns]:
    """Return the tables in a calibration's folder by name; add errors for invalid ones."""
    found = {
        name: read_raw_table(folder / file, findings)
        for name, file in TABLE_FILES.items()
        if (folder / file).exists()
    }
    return {name: _CHECKS[name](table) for name, table in found.items() if table is not None}


def check_tables(tables: Mapping[str, Columns], findings: Findings) -> None:
    """Add an error for everything in tables in memory that could not be read back."""
    for name, columns in tables.items():
        file = TABLE_FILES[name]
        lengths = {len(column) for column in columns.values()}
        if len(lengths) != 1:
            findings.error(file, "columns of one length", f"lengths {sorted(lengths) or 'of no column'}")
            continue
        _CHECKS[name](RawTable(Sheet(findings, file, None), lengths.pop(), columns))


def check_grid(table: RawTable) -> Columns:
    """Return the evaluated grid, after checking that it holds only numbers."""
    reader = ColumnReader(table)
    return {name: reader.numbers(name) for name in table.columns}


def check_draws(table: RawTable) -> Columns:
    """Return the posterior draws, after checking for known parameters, finite numbers and at least one row."""
    reader = ColumnReader(table)
    unknown = [name for name in table.columns if not _is_parameter(name)]
    if unknown or not table.columns:
        expected = f"columns {', '.join(PARAMETERS)}, or effects.NAME.PARAMETER with single numbers"
        reader.sheet.findings.error(reader.sheet.file, expected, ", ".join(unknown) or "no columns")
    if not reader.rows:
        reader.sheet.findings.error(reader.sheet.file, "one draw or more", "no rows")
    return {name: reader.checked(name, ANY, may_be_nan=False) for name in table.columns}


def check_slack(table: RawTable) -> Columns:
    """Return the slack table with :data:`SLACK_COLUMNS`, one row per press; other columns are kept as they are."""
    reader = ColumnReader(table)
    reader.require(tuple(SLACK_COLUMNS))
    columns: dict[str, NDArray[Any]] = {}
    for name, column in table.columns.items():
        if name == "press":
            columns[name] = reader.whole(name, "a whole number, 0 or more", low=0)
        elif name in ("used", "good"):
            columns[name] = _flag(reader, name, column)
        elif name == "reason":
            columns[name] = reader.text(name)
        elif name in ("x_m", "y_m", "z_m", "slack_across_m", "slack_along_m"):
            columns[name] = reader.checked(name, ANY)
        elif name == "residual_rms_counts":
            columns[name] = reader.checked(name, NOT_NEGATIVE)
        else:
            columns[name] = column
    return columns


_CHECKS: Final = {"grid": check_grid, "slack": check_slack, "draws": check_draws}
"""Check of each table."""


def _flag(reader: ColumnReader, name: str, column: NDArray[Any]) -> NDArray[np.bool_]:
    """Return a column of true or false; add an error if it holds anything else."""
    if column.dtype == np.bool_:
        return column
    reader.sheet.findings.error(reader.sheet.column(name), "true or false in every row", "something else")
    return np.zeros(reader.rows, dtype=np.bool_)


def _is_parameter(name: str) -> bool:
    """Return whether a column of draws names a parameter of the model or of an effect."""
    head, _, parameter = name.removeprefix("effects.").partition(".")
    if name.startswith("effects.") and head in EFFECTS:
        return any(p.name == parameter and p.shape == "scalar" for p in EFFECTS[head].parameters)
    return name in PARAMETERS
