"""``dataset.toml`` and the files that it names, meshes and positions of taxels; the hash of a dataset."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skincal.bounded import MOST_MESH_BYTES, parse_toml, read_bytes, read_text
from skincal.covariates import ANY, POSITIVE
from skincal.dataset import table_file
from skincal.dataset.columns import ColumnReader, repeated
from skincal.dataset.dataset import mesh_arrays
from skincal.dataset.findings import Findings
from skincal.dataset.keys import MILLIMETRES, TWICE
from skincal.dataset.schema import Table, load_toml, plain_table, read_table
from skincal.dataset.spec import FORMAT, DatasetMeta, IndenterSpec, SensorSpec, SurfaceSpec
from skincal.dataset.table_file import SUFFIXES, RawTable, file_state
from skincal.dataset.tables import TaxelPositions
from skincal.errors import first_of, readable, text_of
from skincal.files import open_input, reason

FILE = "dataset.toml"


def read_meta(folder: Path, findings: Findings) -> DatasetMeta | None:
    """Return the content of ``dataset.toml``; None if the file is missing or not TOML.

    A wrong value adds an error and reads as a placeholder, so that the tables can still be checked against the rest.
    """
    values = load_toml(folder / FILE, findings, what="dataset", within=folder)
    if values is None:
        return None
    if "created" not in values:
        findings.warn(f"{FILE}, created", "a date and time", "nothing")
    return read_table(DatasetMeta, values, findings, FILE, FORMAT)


def write_meta(meta: DatasetMeta, path: Path) -> None:
    """Write ``dataset.toml``, without keys whose value is None."""
    import tomli_w

    plain = {name: plain_table(v) if isinstance(v, Table) else v for name, v in plain_table(meta).items()}
    order = ("created", "source", "assumed", "wiring")
    top: dict[str, Any] = {"format": FORMAT} | {name: plain[name] for name in order if name in plain}
    path.write_bytes(readable(tomli_w.dumps(top | plain)).encode())


def dataset_hash(path: str | Path) -> str:
    """Return the SHA-256 over names and contents of the files of a dataset, in hexadecimal, 64 characters.

    These are ``dataset.toml``, the tables, and the files that ``dataset.toml`` names; a README does not count.

    Raises:
        OSError: a file cannot be read.
        ValueError: ``dataset.toml`` is not a TOML file.
    """
    folder = Path(path)
    values = parse_toml(read_text(folder / FILE, within=folder))
    keys = (("surface", "file"), ("indenter", "file"), ("sensor", "positions"))
    return hash_of(folder, [values.get(table, {}).get(key) for table, key in keys])


def hash_of(folder: Path, named: Iterable[str | None]) -> str:
    """Return the :func:`dataset_hash` of a folder; ``named`` are the files that its ``dataset.toml`` names."""
    digest = hashlib.sha256()
    for name in sorted(_names(folder, named)):
        file = folder / name
        digest.update(f"{name}\0{file.stat().st_size}\0".encode())
        with open_input(file, folder) as stream:
            while block := stream.read(1 << 20):
                digest.update(block)
    return digest.hexdigest()


def file_states(folder: Path, named: Iterable[str | None]) -> dict[str, tuple[int, ...]]:
    """Return the state of each file of a dataset, which changes when it is replaced; missing files are left out."""
    found: dict[str, tuple[int, ...]] = {}
    for name in _names(folder, named):
        with suppress(OSError):
            found[name] = file_state(folder / name)
    return found


def _names(folder: Path, named: Iterable[str | None]) -> set[str]:
    tables = [f"{stem}{suffix}" for stem in ("presses", "frames") for suffix in SUFFIXES]
    return {FILE} | {name for name in (*named, *tables) if name and (folder / name).is_file()}


COLUMNS = ("r", "c", "u_m", "v_m", "du_m", "dv_m")
COUNT = "Rows and columns count from 0; or correct rows and cols in dataset.toml."

LARGEST_M, SMALLEST_M = 1.0, 1e-4
"""Largest and smallest plausible extent of a mesh in metres."""

COPY = "Copy it there, and write its name without a path."
EXPORT = "Export the mesh again; was the file cut short?"


def read_positions(folder: Path, file: str, sensor: SensorSpec, findings: Findings) -> TaxelPositions | None:
    """Return the taxel positions that ``[sensor] positions`` names; None for a grid, or with an error added."""
    name = sensor.positions
    if not name:
        if (folder / "taxels.csv").is_file():
            expected = f'positions = "taxels.csv" in {file}, [sensor]'
            findings.warn("taxels.csv", expected, "nothing", "It is not used.")
        return None
    path = _path_in_folder(folder, name, f"{file}, [sensor] positions", findings)
    table = None if path is None else table_file.read_table(path, findings)
    return None if table is None else _positions_from(table, sensor)


def read_meshes(
    folder: Path, file: str, surface: SurfaceSpec, indenter: IndenterSpec, findings: Findings
) -> dict[str, bytes]:
    """Return the content of the mesh files that ``[surface]`` and ``[indenter]`` of ``file`` name, by name."""
    found = {
        name: _mesh(folder, f"{file}, [{table}] file", name, findings)
        for table, name in (("surface", surface.file), ("indenter", indenter.file))
        if name
    }
    return {name: content for name, content in found.items() if content is not None}


def _path_in_folder(folder: Path, name: str, place: str, findings: Findings) -> Path | None:
    if Path(name).name == name and (folder / name).exists():
        return folder / name
    findings.error(place, "a file in the same folder", f'"{name}": no such file', COPY)
    return None


def _mesh(folder: Path, place: str, name: str, findings: Findings) -> bytes | None:
    path = _path_in_folder(folder, name, place, findings)
    if path is None:
        return None
    try:
        content = read_bytes(path, MOST_MESH_BYTES, folder)
        vertices, _ = mesh_arrays(content, name)
    except OSError as error:
        findings.error(place, "a file in the same folder", f'"{name}": {reason(error)}', COPY)
        return None
    except ValueError as error:
        findings.error(name, "a triangle mesh (STL, OBJ, PLY, …)", text_of(error), EXPORT)
        return None
    extent = float(np.ptp(vertices, axis=0).max())
    if extent > LARGEST_M:
        fix = "It looks like millimetres; the file is in metres: scale it by 0.001."
        findings.error(name, f"a mesh in metres, at most {LARGEST_M:g} m wide", f"{extent:g} m", fix)
    elif extent < SMALLEST_M:
        findings.error(name, f"a mesh in metres, at least {SMALLEST_M:g} m wide", f"{extent:g} m", TWICE)
    return content


def _positions_from(table: RawTable, sensor: SensorSpec) -> TaxelPositions | None:
    """Return the positions of the taxels in a table, in the order of the flat index.

    Every taxel of ``rows`` x ``cols`` must occur once. Problems are added to the table's findings.
    """
    if not sensor.taxels:  # rows or cols are invalid, which has been reported
        return None
    reader = ColumnReader(table)
    reader.require(COLUMNS)
    if not all(reader.has(name) for name in COLUMNS):
        return None
    r = reader.whole("r", f"a whole number below {sensor.rows}", low=0)
    c = reader.whole("c", f"a whole number below {sensor.cols}", low=0)
    centres = reader.checked_matrix(COLUMNS[2:4], ANY, may_be_nan=False)
    sizes = reader.checked_matrix(COLUMNS[4:], POSITIVE, may_be_nan=False)
    for name, values in zip(COLUMNS[2:], (*centres.T, *sizes.T), strict=True):
        too_large = np.abs(values) > LARGEST_M
        reader.sheet.bad_rows(name, too_large, values, f"at most {LARGEST_M:g} m", MILLIMETRES)
    reader.sheet.bad_rows("r", r >= sensor.rows, r, f"a row below [sensor] rows = {sensor.rows}", COUNT)
    reader.sheet.bad_rows("c", c >= sensor.cols, c, f"a column below [sensor] cols = {sensor.cols}", COUNT)
    if (np.minimum(r, c) < 0).any():  # the taxel cannot be identified
        return None
    flat, names = r * sensor.cols + c, sensor.taxel_columns()
    copies = repeated(flat)
    # A taxel that does not exist is named by its index.
    known = [names[j] if j < len(names) else str(j) for j in flat]
    reader.sheet.bad_rows("r, c", copies, known, "each taxel once", "Remove the copy.")
    missing = np.setdiff1d(np.arange(sensor.taxels), flat)
    if missing.size:
        got = f"none for {first_of((names[j] for j in missing), 6)}"
        fix = "Where the image has gaps, number the taxels in one row: rows = 1, cols = their number."
        reader.sheet.findings.error(reader.sheet.file, "a row for every taxel of rows x cols", got, fix)
    if missing.size or copies.any() or len(flat) != sensor.taxels:
        return None
    order = np.argsort(flat)
    return TaxelPositions(centres[order], sizes[order])


def position_columns(sensor: SensorSpec, positions: TaxelPositions) -> dict[str, NDArray[Any]]:
    """Return the taxel positions as columns of ``taxels.csv``."""
    r, c = np.divmod(np.arange(sensor.taxels), sensor.cols)
    numbers = (*positions.centres_m.T, *positions.sizes_m.T)
    return dict(zip(COLUMNS, (r, c, *numbers), strict=True))
