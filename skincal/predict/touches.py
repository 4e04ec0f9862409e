"""The contacts of a table's rows on a calibrated skin."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from skincal.calibration import Calibration
from skincal.dataset import IDLE, Dataset
from skincal.dataset.columns import NORMAL
from skincal.errors import WorkError
from skincal.model import Contacts, Indenter, Skin, Surface

Floats = NDArray[np.floating[Any]]
Ints = NDArray[np.intp]

CHUNK = 10_000
"""Contacts simulated between two reports of progress."""

Progress = Callable[[int, int], None]


@dataclass(frozen=True, eq=False)
class CalibratedSkin:
    """A skin, the surface it lies on, and the indenters of a dataset by their radius.

    Attributes:
        skin: of the calibration.
        surface: that carries it.
        centre_m: (3,) the centre of its patch [m].
        indenters: by radius in nanometres; 0 for one that has none (a mesh).
    """

    skin: Skin
    surface: Surface
    centre_m: Floats
    indenters: Mapping[int, Indenter]

    @classmethod
    def of(cls, calibration: Calibration, dataset: Dataset) -> Self:
        """The skin of a calibration, to be pressed by a dataset's indenters.

        Raises:
            WorkError: the skin cannot be simulated.
        """
        surface = calibration.surface_model()
        try:
            skin = calibration.skin()
        except ValueError as error:
            raise WorkError(f"the calibrated patch has no place on its surface: {error}") from error
        centre = surface.wrap(calibration.pose(), np.zeros((1, 2)))[0][0]
        radii = [dataset.indenter_radii_m()]
        if dataset.frames is not None and (own := dataset.frames.column("indenter_radius_m")) is not None:
            radii.append(own)
        keys = np.unique(radius_keys(np.concatenate(radii)))
        indenters = {int(key): dataset.indenter(None if key == 0 else key * 1e-9) for key in keys}
        return cls(skin, surface, centre, indenters)


def radius_keys(radii_m: Floats) -> Ints:
    """Radii in whole nanometres, 0 where there is none, to tell indenters apart."""
    return np.rint(np.nan_to_num(radii_m) * 1e9).astype(np.intp)


@dataclass(frozen=True, eq=False)
class Touches:
    """N contacts; a row whose place is not known has NaN, one without force gives the level at rest.

    Attributes:
        on: the skin.
        points_m: (N, 3) contact points on the surface [m].
        normals: (N, 3) measured normals, NaN where not measured; None: the surface's own everywhere.
        force_n: (N,) normal forces [N].
        indenter: (N,) keys of ``on.indenters``.
    """

    on: CalibratedSkin
    points_m: Floats
    normals: Floats | None
    force_n: Floats
    indenter: Ints

    @classmethod
    def of_presses(cls, on: CalibratedSkin, dataset: Dataset) -> Self:
        """The presses of a dataset at their measured positions."""
        presses = dataset.presses
        points = _on_surface(on, presses.position_m, unknown=not np.isfinite(dataset.meta.position.sigma_m))
        return cls(on, points, presses.normals, presses.force_n, radius_keys(dataset.indenter_radii_m()))

    @classmethod
    def of_frames(cls, on: CalibratedSkin, dataset: Dataset) -> Self:
        """The frames of a dataset at their measured positions; an idle one has no force."""
        frames = dataset.frames
        assert frames is not None
        points = _on_surface(on, frames.position_m, unknown=not np.isfinite(dataset.meta.position.sigma_m))
        force = np.where(touching(dataset), frames.force_n, 0.0)
        own = [frames.column(name) for name in NORMAL]
        normals = (
            np.stack([c for c in own if c is not None], axis=1) if all(c is not None for c in own) else None
        )
        radii = dataset.indenter_radii_m()[frame_presses(dataset)]
        if (
            dataset.meta.indenter.kind != "mesh"
            and (column := frames.column("indenter_radius_m")) is not None
        ):
            radii = np.where(np.isnan(column), radii, column)
        return cls(on, points, normals, force, radius_keys(radii))

    def __len__(self) -> int:
        return len(self.force_n)

    def moved(self, slack_m: Floats) -> Self:
        """The contacts moved over the surface by slacks (N, 2) across and along [m]."""
        points = np.array(self.points_m, dtype=np.float64)
        known = np.isfinite(points).all(axis=1) & (slack_m != 0).any(axis=1)
        points[known] = self.on.surface.offset(points[known], slack_m[known, 0], slack_m[known, 1])
        return replace(self, points_m=points)

    def taken(self, rows: Ints) -> Self:
        """Some of the contacts, or some several times."""
        return replace(
            self,
            points_m=self.points_m[rows],
            normals=None if self.normals is None else self.normals[rows],
            force_n=self.force_n[rows],
            indenter=self.indenter[rows],
        )

    def values(self, progress: Progress | None = None) -> Floats:
        """Values (N, J) of the taxels [counts], neither clipped nor rounded."""
        out = np.zeros((len(self), self.on.skin.patch.layout.taxels))
        pressed = np.flatnonzero(self.force_n > 0)
        # Rows of one indenter stand together, so that a chunk holds few of them.
        pressed = pressed[np.argsort(self.indenter[pressed], kind="stable")]
        for first in range(0, len(pressed), CHUNK):
            rows = pressed[first : first + CHUNK]
            for key in np.unique(self.indenter[rows]):
                mine = rows[self.indenter[rows] == key]
                out[mine] = self.on.skin.values(self.on.indenters[int(key)], self._contacts(mine))
            if progress is not None:
                progress(min(first + CHUNK, len(pressed)), len(pressed))
        return out

    def _contacts(self, rows: Ints) -> Contacts:
        points = np.asarray(self.points_m[rows], dtype=np.float64)
        normals = np.full((len(rows), 3), np.nan)
        if self.normals is not None:
            # Measured normals are unit vectors to the digits of the file only.
            normals[:] = self.normals[rows] / np.linalg.norm(self.normals[rows], axis=1, keepdims=True)
        open_ = ~np.isfinite(normals).all(axis=1)
        known = open_ & np.isfinite(points).all(axis=1)
        # A place that is not known gives NaN whatever its normal.
        normals[open_] = [0.0, 0.0, 1.0]
        normals[known] = self.on.surface.normal_at(points[known])
        return Contacts(points, normals, np.asarray(self.force_n[rows], dtype=np.float64))


def touching(dataset: Dataset) -> NDArray[np.bool_]:
    """Which frames (M,) have contact: they belong to a press and are not idle."""
    frames = dataset.frames
    assert frames is not None
    return (frames.phase != IDLE) & (frames.press >= 0)


def frame_presses(dataset: Dataset) -> Ints:
    """Row of the table of presses (M,) that each frame belongs to; 0 for a frame of none."""
    frames, press = dataset.frames, dataset.presses.press
    assert frames is not None
    order = np.argsort(press)
    place = np.minimum(np.searchsorted(press[order], frames.press), len(press) - 1)
    return np.where(frames.press >= 0, order[place], 0).astype(np.intp)


def _on_surface(on: CalibratedSkin, position_m: Floats, *, unknown: bool) -> Floats:
    """Measured positions (N, 3) taken to the surface.

    Args:
        on: the skin.
        position_m: (N, 3) measured positions [m].
        unknown: the data say that nothing is known of positions; one that is missing then is the patch's centre.
    """
    points = np.array(position_m, dtype=np.float64)
    given = np.isfinite(points).all(axis=1)
    points[given] = on.surface.project(points[given])
    points[~given] = on.centre_m if unknown else np.nan
    return points
