"""The contacts of a table's rows on a calibrated skin, and their values by the base model."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from skincal.calibration import Calibration, skin_of
from skincal.covariates import NORMAL
from skincal.dataset import IDLE, Dataset
from skincal.effects import EffectSkin
from skincal.errors import WorkError
from skincal.fitting.types import Floats, Ints
from skincal.model import Contacts, Indenter, Skin, Surface

CHUNK = 10_000
"""Number of contacts simulated between two progress reports."""

Progress = Callable[[int, int], None]

Indenters = tuple[tuple[Indenter, ...], Ints]
"""All indenters, and the index (N,) of each contact's."""


@dataclass(frozen=True, eq=False)
class CalibratedSkin:
    """A skin, its surface, and the indenters of a dataset by radius.

    Attributes:
        skin: skin of the calibration, without its effects.
        full: skin with its effects; an effect without its covariates is left out.
        surface: surface of the fingertip.
        centre_m: (3,) centre of the patch [m].
        indenters: indenters by radius in nanometres; 0 for a mesh.
    """

    skin: Skin
    full: EffectSkin
    surface: Surface
    centre_m: Floats
    indenters: Mapping[int, Indenter]

    @classmethod
    def of(cls, calibration: Calibration, dataset: Dataset, poses: Sequence[str] = ()) -> Self:
        """Return the skin of a calibration, with the indenters of a dataset.

        Raises:
            InputError: effects or parameters are unknown.
            WorkError: the skin cannot be simulated.
        """
        try:
            full = skin_of(calibration, missing="abstain", poses=poses)
        except ValueError as error:
            raise WorkError(f"the calibrated patch does not fit on its surface: {error}") from error
        surface = full.surface
        centre = surface.wrap(calibration.pose(), np.zeros((1, 2)))[0][0]
        radii = [dataset.indenter_radii_m()]
        if dataset.frames is not None and (own := dataset.frames.column("indenter_radius_m")) is not None:
            radii.append(own)
        keys = np.unique(radius_keys(np.concatenate(radii)))
        indenters = {int(key): dataset.indenter(None if key == 0 else key * 1e-9) for key in keys}
        return cls(full.skin, full, surface, centre, indenters)

    @property
    def has_effects(self) -> bool:
        """True if the skin has more than the base model."""
        return not all(one.neutral for one in self.full.effects)


def radius_keys(radii_m: Floats) -> Ints:
    """Return the radii (N,) in whole nanometres as keys of indenters; 0 without a radius."""
    return np.rint(np.nan_to_num(radii_m) * 1e9).astype(np.intp)


@dataclass(frozen=True, eq=False)
class Touches:
    """N contacts; a row of unknown position is NaN, and one without force gives the rest level.

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
    def of_presses(cls, on: CalibratedSkin, dataset: Dataset, slack_m: Floats | None = None) -> Self:
        """Return the presses of a dataset, moved from their measured positions by slacks (P, 2) [m]; None: 0."""
        presses = dataset.presses
        points = _on_surface(on, presses.position_m, unknown=not np.isfinite(dataset.meta.position.sigma_m))
        made = cls(on, points, presses.normals, presses.force_n, radius_keys(dataset.indenter_radii_m()))
        return made if slack_m is None else made.moved(slack_m)

    @classmethod
    def of_frames(cls, on: CalibratedSkin, dataset: Dataset, slack_m: Floats | None = None) -> Self:
        """Return the frames of a dataset, moved with their presses by slacks (P, 2) [m]; idle frames have no force."""
        frames = dataset.frames
        assert frames is not None
        points = _on_surface(on, frames.position_m, unknown=not np.isfinite(dataset.meta.position.sigma_m))
        owner, contact = frame_presses(dataset), touching(dataset)
        force = np.where(contact, frames.force_n, 0.0)
        radii = dataset.indenter_radii_m()[owner]
        column = frames.column("indenter_radius_m")
        if column is not None and dataset.meta.indenter.radius_m is not None:
            radii = np.where(np.isnan(column), radii, column)
        made = cls(on, points, frame_normals(dataset), force, radius_keys(radii))
        return made if slack_m is None else made.moved(np.where(contact[:, None], slack_m[owner], 0.0))

    def __len__(self) -> int:
        return len(self.force_n)

    def moved(self, slack_m: Floats) -> Self:
        """Return the contacts moved over the surface by slacks (N, 2) across and along [m]."""
        points = np.array(self.points_m, dtype=np.float64)
        known = np.isfinite(points).all(axis=1) & (slack_m != 0).any(axis=1)
        points[known] = self.on.surface.offset(points[known], slack_m[known, 0], slack_m[known, 1])
        return replace(self, points_m=points)

    def select(self, rows: Ints) -> Self:
        """Return the contacts of the given rows (n,), which may repeat."""
        return replace(
            self,
            points_m=self.points_m[rows],
            normals=None if self.normals is None else self.normals[rows],
            force_n=self.force_n[rows],
            indenter=self.indenter[rows],
        )

    def values(self, progress: Progress | None = None) -> Floats:
        """Return the values of the taxels (N, J) [counts], neither clipped nor rounded."""
        out = np.zeros((len(self), self.on.skin.patch.layout.taxels))
        pressed = np.flatnonzero(self.force_n > 0)
        # Sort rows by indenter, so that a chunk contains few different ones.
        pressed = pressed[np.argsort(self.indenter[pressed], kind="stable")]
        for first in range(0, len(pressed), CHUNK):
            rows = pressed[first : first + CHUNK]
            for key in np.unique(self.indenter[rows]):
                mine = rows[self.indenter[rows] == key]
                out[mine] = self.on.skin.values(self.on.indenters[int(key)], self.select(mine).contacts())
            if progress is not None:
                progress(min(first + CHUNK, len(pressed)), len(pressed))
        return out

    def contacts(self) -> Contacts:
        """Return the contacts, with the surface's own normals where none were measured."""
        points = np.asarray(self.points_m, dtype=np.float64)
        normals = np.full((len(self), 3), np.nan)
        if self.normals is not None:
            # Measured normals are unit vectors only to the precision of the file.
            normals[:] = self.normals / np.linalg.norm(self.normals, axis=1, keepdims=True)
        missing = ~np.isfinite(normals).all(axis=1)
        known = missing & np.isfinite(points).all(axis=1)
        # An unknown position gives NaN for any normal.
        normals[missing] = [0.0, 0.0, 1.0]
        normals[known] = self.on.surface.normal_at(points[known])
        return Contacts(points, normals, np.asarray(self.force_n, dtype=np.float64))

    def indenters(self) -> Indenters:
        """Return all indenters, and the index (N,) of each contact's."""
        keys = np.array(sorted(self.on.indenters), dtype=np.intp)
        indenters = tuple(self.on.indenters[int(key)] for key in keys)
        return indenters, np.searchsorted(keys, self.indenter)


def touching(dataset: Dataset) -> NDArray[np.bool_]:
    """Return which frames (M,) have contact: they belong to a press and are not idle."""
    frames = dataset.frames
    assert frames is not None
    return (frames.phase != IDLE) & (frames.press >= 0)


def frame_presses(dataset: Dataset) -> Ints:
    """Return the row (M,) of each frame's press in the table of presses; 0 for a frame without press."""
    return np.maximum(dataset.frame_presses(), 0)


def frame_normals(dataset: Dataset) -> Floats | None:
    """Return the measured normals of the frames (M, 3), else those of their presses; None without either."""
    frames = dataset.frames
    assert frames is not None
    parts = [c for name in NORMAL if (c := frames.column(name)) is not None]
    own = np.stack(parts, axis=1) if len(parts) == len(NORMAL) else None
    of = dataset.presses.normals
    if of is None:
        return own
    of = np.where((frames.press >= 0)[:, None], of[frame_presses(dataset)], np.nan)
    return of if own is None else np.where(np.isfinite(own).all(axis=1, keepdims=True), own, of)


def _on_surface(on: CalibratedSkin, position_m: Floats, *, unknown: bool) -> Floats:
    """Return the measured positions (N, 3) on the surface; a missing one is the patch's centre if ``unknown``."""
    points = np.array(position_m, dtype=np.float64)
    given = np.isfinite(points).all(axis=1)
    points[given] = on.surface.project(points[given])
    points[~given] = on.centre_m if unknown else np.nan
    return points
