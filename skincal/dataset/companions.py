"""Files that a description names: meshes, and the positions of taxels that form no grid."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from skincal.bounded import MOST_MESH_BYTES, read_bytes
from skincal.dataset.findings import Findings
from skincal.dataset.keys import TWICE
from skincal.dataset.model_objects import mesh_arrays
from skincal.dataset.position_table import positions_from
from skincal.dataset.spec import IndenterSpec, SensorSpec, SurfaceSpec
from skincal.dataset.table_file import read_table
from skincal.dataset.tables import TaxelPositions
from skincal.errors import text_of
from skincal.files import reason

LARGEST_M, SMALLEST_M = 1.0, 1e-4
"""Extents that no mesh in metres has: too small, too large."""

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
    path = _beside(folder, name, f"{file}, [sensor] positions", findings)
    table = None if path is None else read_table(path, findings)
    return None if table is None else positions_from(table, sensor)


def read_meshes(
    folder: Path, file: str, surface: SurfaceSpec, indenter: IndenterSpec, findings: Findings
) -> dict[str, bytes]:
    """Return the content of the mesh files that ``[surface]`` and ``[indenter]`` of ``file`` name, by name."""
    found: dict[str, bytes] = {}
    for table, spec in (("surface", surface), ("indenter", indenter)):
        if (
            spec.file
            and (content := _mesh(folder, f"{file}, [{table}] file", spec.file, findings)) is not None
        ):
            found[spec.file] = content
    return found


def _beside(folder: Path, name: str, place: str, findings: Findings) -> Path | None:
    """Return the path of a file that a description names; None, with an error added, if it is not in the folder."""
    if Path(name).name == name and (folder / name).exists():
        return folder / name
    findings.error(place, "a file in the same folder", f'"{name}": no such file', COPY)
    return None


def _mesh(folder: Path, place: str, name: str, findings: Findings) -> bytes | None:
    path = _beside(folder, name, place, findings)
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
