"""A dataset in memory: its tables, and the model objects that it describes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from skincal.dataset.model_objects import converter_of, indenter_of, layout_of, pose_of, surface_of
from skincal.dataset.spec import DatasetMeta
from skincal.dataset.tables import Frames, Presses, TaxelPositions
from skincal.errors import Problem, WorkError
from skincal.model.arrays import FloatArray
from skincal.shown import Shown
from skincal.units import in_unit

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
