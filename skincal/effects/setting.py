"""The geometry that effects use: the patch, its surface, and the arrangement of the taxels."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from skincal.effects.samples import Samples
from skincal.model import Patch, Surface, contact_rotations
from skincal.model.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class Setting:
    """Geometry of the skin, for effects that need it."""

    patch: Patch
    surface: Surface

    @property
    def taxels(self) -> int:
        """Number of taxels J."""
        return self.patch.layout.taxels

    @cached_property
    def centre_m(self) -> FloatArray:
        """Centre of the taxels on the surface (3,) [m]."""
        mean = self.patch.points_m[self.patch.taxel >= 0].mean(axis=0)
        return self.surface.project(mean[None])[0]

    @cached_property
    def axes(self) -> FloatArray:
        """Unit vectors at the centre (2, 3): across (towards growing beta) and along (+y)."""
        return contact_rotations(self.surface.normal_at(self.centre_m[None]))[0].T[:2]

    @cached_property
    def neighbours(self) -> FloatArray:
        """Adjacency (J, J): one for neighbouring taxels, else zero.

        Two taxels are neighbours if no other taxel lies in or on the circle between their centres (Gabriel and Sokal
        1969): in a grid the next in row and column, in a hexagonal layout the six around a taxel.
        """
        centres = self.patch.layout.centres_m
        square = ((centres[:, None] - centres) ** 2).sum(axis=-1)
        # A point lies in the circle if its squared distances from both ends add up to less than the diameter's square.
        between = square[:, None, :] + square[None, :, :] <= square[:, :, None] * (1 + 1e-6)
        ends = np.eye(self.taxels, dtype=bool)
        between &= ~(ends[:, None, :] | ends[None, :, :])
        return ((square > 0) & ~between.any(axis=-1)).astype(np.float64)

    @cached_property
    def wires(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Indicators (J, J), one for two different taxels that share their row, their column, or neither."""
        own = np.eye(self.taxels)
        row, col = np.divmod(np.arange(self.taxels), self.patch.layout.cols)
        same_row, same_column = (row[:, None] == row) - own, (col[:, None] == col) - own
        return same_row, same_column, 1.0 - own - same_row - same_column

    def moved(self, samples: Samples, across_m: FloatArray, along_m: FloatArray) -> Samples:
        """Return samples with contacts moved over the surface; a free object moves along without turning.

        Normals turn as the surface's own normals do from the old place to the new one.

        Args:
            samples: K samples.
            across_m: (K,) towards growing beta [m].
            along_m: (K,) along +y [m].
        """
        contacts = samples.contacts
        known = np.isfinite(contacts.points_m).all(axis=1) & np.isfinite(contacts.normals).all(axis=1)
        moves = samples.touching & known & ((across_m != 0) | (along_m != 0))
        if not moves.any():
            return samples
        old = self.surface.project(contacts.points_m[moves])
        new = self.surface.offset(old, across_m[moves], along_m[moves])
        points, normals = contacts.points_m.copy(), contacts.normals.copy()
        points[moves] += new - old
        turned = normals[moves] + self.surface.normal_at(new) - self.surface.normal_at(old)
        normals[moves] = turned / np.linalg.norm(turned, axis=1, keepdims=True)
        changes = {"points_m": points, "normals": normals}
        if contacts.origins_m is not None:
            changes["origins_m"] = contacts.origins_m.copy()
            changes["origins_m"][moves] += new - old
        return replace(samples, contacts=replace(contacts, **changes))
