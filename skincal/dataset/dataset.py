"""A dataset in memory: its tables, the model objects that its description stands for, and two sessions as one."""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from skincal.covariates import TIMES
from skincal.dataset.kinds import INDENTERS, SURFACES, Kind
from skincal.dataset.spec import DatasetMeta, IndenterSpec, MountSpec, SensorSpec, SurfaceSpec
from skincal.dataset.tables import Frames, Presses, TaxelPositions
from skincal.errors import InputError, Problem, WorkError, input_error, quoted
from skincal.model.arrays import FloatArray, IntArray
from skincal.shown import Shown
from skincal.units import in_unit, rad

if TYPE_CHECKING:
    from skincal.model import Converter, Indenter, SensorPose, Surface, TaxelLayout


@dataclass(frozen=True, eq=False)
class Dataset(Shown):
    """A dataset that has been read and checked.

    Attributes:
        meta: the content of ``dataset.toml``.
        presses: one row per press.
        frames: one row per time sample; None without frames.
        positions: positions of taxels that form no grid; None for a grid.
        meshes: content of the mesh files that ``meta`` names, by file name.
        folder: the folder it was read from; None for a dataset made in memory.
        sha256: hash of its files (see ``dataset_hash``); None for a dataset made in memory.
        warnings: warnings; the data can still be used.
    """

    meta: DatasetMeta
    presses: Presses
    frames: Frames | None = None
    positions: TaxelPositions | None = None
    meshes: Mapping[str, bytes] = field(default_factory=dict)
    folder: Path | None = None
    sha256: str | None = None
    warnings: tuple[Problem, ...] = ()

    def __repr__(self) -> str:
        name = "dataset" if self.folder is None else str(self.folder)
        frames = "no frames" if self.frames is None else f"{len(self.frames)} frames"
        sensor = f"{self.meta.sensor.rows} x {self.meta.sensor.cols} taxels"
        return f"<Dataset {name}: {len(self.presses)} presses, {frames}, {sensor}>"

    def layout(self) -> TaxelLayout:
        """Return the layout of the taxels: the grid of ``[sensor]``, or the table of positions."""
        return layout_of(self.meta.sensor, self.positions)

    def surface(self) -> Surface:
        """Return the surface that carries the sensor."""
        return surface_of(self.meta.surface, self.meshes)

    def indenter(self, radius_m: float | None = None) -> Indenter:
        """Return the indenter; a radius [m] that is neither None nor NaN overrides that of ``[indenter]``.

        A mesh has no radius and ignores it.
        """
        return indenter_of(self.meta.indenter, self.meshes, radius_m)

    def indenters(self) -> tuple[tuple[Indenter, ...], NDArray[np.intp]]:
        """Return the different indenters of the presses, and the index (K,) of each press's indenter."""
        radii = np.round(self.indenter_radii_m(), 7)
        if np.isnan(radii).all():
            return (self.indenter(),), np.zeros(len(radii), dtype=np.intp)
        different, kinds = np.unique(radii, return_inverse=True)
        return tuple(self.indenter(float(r)) for r in different), kinds.astype(np.intp).reshape(-1)

    def indenter_radii_m(self) -> FloatArray:
        """Return the radius of the indenter in each press [m], shape (K,); NaN for a mesh."""
        own, default = self.presses.column("indenter_radius_m"), self.meta.indenter.radius_m
        radii = np.full(len(self.presses), np.nan if default is None else default)
        return radii if own is None or default is None else np.where(np.isnan(own), radii, own)

    def frame_presses(self) -> NDArray[np.intp]:
        """Return the row (M,) of each frame's press in the table of presses; -1 for a frame without press."""
        assert self.frames is not None
        own, wanted = self.presses.press, self.frames.press
        if not len(own):
            return np.full(len(wanted), -1, dtype=np.intp)
        order = np.argsort(own, kind="stable")
        row = order[np.minimum(np.searchsorted(own[order], wanted), len(own) - 1)]
        return np.where(own[row] == wanted, row, -1)

    def nominal_pose(self) -> SensorPose:
        """Return the nominal pose of ``[mount]``."""
        return pose_of(self.meta.mount)

    def converter(self) -> Converter:
        """Return the converter of ``[sensor]``."""
        return converter_of(self.meta.sensor)


def refusal(dataset: Dataset, reason: str) -> WorkError:
    """Return the error for a dataset that cannot be used for a reason."""
    end = "" if reason.endswith((".", "?")) else "."
    text = in_unit(reason, dataset.meta.sensor.unit)
    return WorkError(f"{dataset.folder or 'the dataset'}: {text}{end}")


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


GAP_S = 10.0
"""Gap between the sessions if the clock of the second one has restarted [s]."""

Table = TypeVar("Table", Presses, Frames)


def join_sessions(first: Dataset, second: Dataset) -> Dataset:
    """Concatenate a session and a later one of the same rig, with continued press numbers and one clock.

    A column that only one session has is empty in the rows of the other.

    Raises:
        InputError: the sessions have different sensors or surfaces, or only one of them has frames.
    """
    place = "dataset" if second.folder is None else str(second.folder)
    check_same_rig(first.meta, second.meta, place)
    if (first.frames is None) != (second.frames is None):
        raise input_error(f"{place}: frames", "frames in both sessions or in none", "frames in one")
    number = int(first.presses.press.max(initial=-1)) + 1
    later, taxels = _later_s(first, second), first.meta.sensor.taxel_columns()
    presses = _concatenated(first.presses, second.presses, number, later, taxels)
    frames = None
    if first.frames is not None and second.frames is not None:
        frames = _concatenated(first.frames, second.frames, number, later, taxels)
    return replace(first, presses=presses, frames=frames, folder=None, sha256=None)


def check_same_rig(first: DatasetMeta, second: DatasetMeta, place: str) -> None:
    """Check that two sessions have the same sensor and surface; ``place`` is the source of the second, for errors.

    Raises:
        InputError: they differ.
    """
    pairs = ((first.sensor, second.sensor, "sensor"), (first.surface, second.surface, "surface"))
    fix = "Press the same sensor."
    if problems := [
        Problem(f"{place}: [{name}]", f"that of the first session, {mine}", str(other), fix)
        for mine, other, name in pairs
        if mine != other
    ]:
        raise InputError(problems)


def _later_s(first: Dataset, second: Dataset) -> float:
    """Return the offset of the second session's clock that places it after the first [s]."""
    ends: list[tuple[float, float]] = []
    if first.frames is not None and second.frames is not None and len(first.frames) and len(second.frames):
        ends.append((float(first.frames.time_s[-1]), float(second.frames.time_s[0])))
    old, new = first.presses.column(TIMES[-1]), second.presses.column(TIMES[0])
    if old is not None and new is not None and np.isfinite(old).any() and np.isfinite(new).any():
        ends.append((float(np.nanmax(old)), float(np.nanmin(new))))
    apart = min((begin - end for end, begin in ends), default=GAP_S)
    return 0.0 if apart > 0 else GAP_S - apart


def _concatenated(first: Table, second: Table, press: int, later_s: float, taxels: tuple[str, ...]) -> Table:
    """Concatenate two tables; a column that one of them lacks is empty there.

    ``press`` is the offset of the second table's press numbers, ``later_s`` that of its times [s].
    """
    import pandas as pd

    a, b = first.to_pandas(taxels), second.to_pandas(taxels)
    b["press"] = b["press"].mask(b["press"] >= 0, b["press"] + press)
    for name in (*TIMES, "time_s"):
        if name in b:
            b[name] += later_s
    for one, other in ((a, b), (b, a)):
        for name in set(other) - set(one):
            number = other[name].dtype.kind in "biuf"
            one[name] = np.nan if number else ""
            other[name] = other[name].astype(float) if number else other[name]
    return type(first).of_pandas(pd.concat([a, b[[*a]]], ignore_index=True), taxels)


def session_times_s(dataset: Dataset) -> FloatArray | None:
    """Return the time of each press: the middle of its hold, or its start [s], shape (K,); None if unknown."""
    column = dataset.presses.column
    hold, release = column("t_hold_s"), column("t_release_s")
    if hold is not None and release is not None:
        return (hold + release) / 2
    return column("t_start_s") if hold is None else hold
