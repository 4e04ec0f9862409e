"""A calibration as a folder: reading reports every fault, writing is complete or not at all."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import tomli_w

from skincal.calibration.calibration import Calibration
from skincal.calibration.draw_tables import TABLE_FILES, check_tables, read_tables
from skincal.calibration.toml_file import FILE, FORMAT, CalibrationFile, plain_file
from skincal.dataset.companions import read_meshes, read_positions
from skincal.dataset.findings import Findings
from skincal.dataset.position_table import position_columns
from skincal.dataset.schema import load_toml, read_table
from skincal.dataset.table_file import write_table
from skincal.files import whole_folder


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
        **content,
        positions=positions,
        meshes=meshes,
        warnings=tuple(findings.warnings),
        folder=folder.resolve(),
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
        (folder / FILE).write_bytes(tomli_w.dumps(plain).encode())
        for name, columns in tables.items():
            write_table(folder / TABLE_FILES[name], columns)
        if calibration.positions is not None:
            columns = position_columns(calibration.sensor, calibration.positions)
            write_table(folder / str(calibration.sensor.positions), columns)
        for name, content in calibration.meshes.items():
            (folder / name).write_bytes(content)
        if beside is not None:
            beside(folder)
