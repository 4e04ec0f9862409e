"""Construction of model objects from a sensor's description; the model is imported on use."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from skincal.dataset.kinds import INDENTERS, SURFACES, Kind
from skincal.dataset.spec import IndenterSpec, MountSpec, SensorSpec, SurfaceSpec
from skincal.dataset.tables import TaxelPositions
from skincal.errors import quoted
from skincal.model.arrays import FloatArray, IntArray
from skincal.units import rad

if TYPE_CHECKING:
    from skincal.model import Converter, Indenter, SensorPose, Surface, TaxelLayout


def layout_of(sensor: SensorSpec, positions: TaxelPositions | None) -> TaxelLayout:
    """Return the layout of the taxels: the grid of ``[sensor]``, or the table of positions if there is one."""
    from skincal.model import TaxelLayout

    rows, cols = sensor.rows, sensor.cols
    if positions is not None:
        return TaxelLayout(rows=rows, cols=cols, centres_m=positions.centres_m, sizes_m=positions.sizes_m)
    assert sensor.taxel_size_m is not None and sensor.pitch_m is not None
    return TaxelLayout.grid(rows, cols, taxel_size_m=sensor.taxel_size_m, pitch_m=sensor.pitch_m)


def surface_of(spec: SurfaceSpec, meshes: Mapping[str, bytes]) -> Surface:
    """Return the surface that carries the sensor; ``meshes`` holds the content of mesh files by name."""
    return _built(SURFACES[spec.kind], spec.numbers, spec.file, meshes)


def indenter_of(spec: IndenterSpec, meshes: Mapping[str, bytes], radius_m: float | None = None) -> Indenter:
    """Return the indenter; a radius [m] that is neither None nor NaN overrides that of ``spec``."""
    own = {} if radius_m is None or np.isnan(radius_m) else {"radius_m": float(radius_m)}
    return _built(INDENTERS[spec.kind], spec.numbers | own, spec.file, meshes)


def _built(kind: Kind, numbers: dict[str, float], file: str | None, meshes: Mapping[str, bytes]) -> Any:
    import skincal.model

    make = getattr(skincal.model, kind.model)
    if kind.mesh:
        assert file is not None
        return make(*mesh_arrays(meshes[file], file))
    return make(**{key: numbers[key] for key in kind.numbers})


def pose_of(mount: MountSpec) -> SensorPose:
    """Return the nominal pose of ``[mount]``."""
    from skincal.model import SensorPose

    return SensorPose(mount.y_m, rad(mount.alpha_deg), rad(mount.beta_deg or 0.0), mount.x_m or 0.0)


def converter_of(sensor: SensorSpec) -> Converter:
    """Return the converter of ``[sensor]``.

    After subtraction of the rest level the clipping points are unknown and the counts are not whole numbers; the
    converter then neither clips nor rounds.
    """
    from skincal.model import Converter

    if sensor.baseline == "subtracted":
        return Converter.none()
    return Converter(value_min=sensor.value_min, value_max=sensor.value_max, integer=sensor.integer)


MESH_SUFFIXES = (".stl", ".obj", ".ply", ".off")
"""Supported mesh formats: uncompressed ones that contain only triangles."""


def mesh_arrays(content: bytes, name: str) -> tuple[FloatArray, IntArray]:
    """Return the vertices [m], shape (V, 3), and the faces, shape (F, 3), of a mesh file, whose suffix is its format.

    Raises:
        ValueError: trimesh cannot read the mesh, or it is empty.
    """
    import trimesh

    kind = Path(name).suffix.lower()
    if kind not in MESH_SUFFIXES:
        raise ValueError(f"a file name that ends in {kind or 'nothing'}, not in {', '.join(MESH_SUFFIXES)}")
    try:
        mesh = trimesh.load(io.BytesIO(content), file_type=kind.lstrip("."), force="mesh")
        vertices = np.asarray(mesh.vertices, dtype=np.float64)  # type: ignore[union-attr]
        faces = np.asarray(mesh.faces, dtype=np.int64)  # type: ignore[union-attr]
    except Exception as error:  # trimesh raises whatever its parsers raise
        raise ValueError(quoted(error)) from error
    if faces.ndim != 2 or not len(faces):
        raise ValueError("no triangles")
    if not np.isfinite(vertices).all() or faces.min() < 0 or faces.max() >= len(vertices):
        raise ValueError("vertices that are not finite, or faces with vertices that do not exist")
    return vertices, faces
