"""Files that a description names: meshes, and the positions of taxels that form no grid."""

from __future__ import annotations

from pathlib import Path

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
            findings.warn(
                "taxels.csv", f'positions = "taxels.csv" in {file}, [sensor]', "nothing", "It is not used."
            )
        return None
    path = folder / name
    if Path(name).name != name or not path.exists():
        findings.error(
            f"{file}, [sensor] positions", "a file in the same folder", f'"{name}": no such file', COPY
        )
        return None
    table = read_table(path, findings)
    return None if table is None else positions_from(table, sensor)


def read_meshes(
    folder: Path, file: str, surface: SurfaceSpec, indenter: IndenterSpec, findings: Findings
) -> dict[str, bytes]:
    """Return the content of the mesh files that ``[surface]`` and ``[indenter]`` of ``file`` name, by name."""
    found: dict[str, bytes] = {}
    for table, spec in (("surface", surface), ("indenter", indenter)):
        content = _mesh(folder, f"{file}, [{table}] file", spec, findings)
        if content is not None and spec.file is not None:
            found[spec.file] = content
    return found


def _mesh(folder: Path, place: str, spec: SurfaceSpec | IndenterSpec, findings: Findings) -> bytes | None:
    if not spec.file:
        return None
    path = folder / spec.file
    if Path(spec.file).name != spec.file or not path.exists():
        findings.error(place, "a file in the same folder", f'"{spec.file}": no such file', COPY)
        return None
    try:
        content = read_bytes(path, MOST_MESH_BYTES, folder)
        vertices, _ = mesh_arrays(content, spec.file)
    except OSError as error:
        findings.error(place, "a file in the same folder", f'"{spec.file}": {reason(error)}', COPY)
        return None
    except ValueError as error:
        findings.error(spec.file, "a triangle mesh (STL, OBJ, PLY, …)", text_of(error), EXPORT)
        return None
    extent = float((vertices.max(axis=0) - vertices.min(axis=0)).max())
    if extent > LARGEST_M:
        fix = "It looks like millimetres; the file is in metres: scale it by 0.001."
        findings.error(spec.file, f"a mesh in metres, at most {LARGEST_M:g} m wide", f"{extent:g} m", fix)
    elif extent < SMALLEST_M:
        findings.error(spec.file, f"a mesh in metres, at least {SMALLEST_M:g} m wide", f"{extent:g} m", TWICE)
    return content
