"""Where an effect takes place: the patch, its surface, and how the taxels lie to each other."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from skincal.effects.samples import Samples
from skincal.model import Patch, Surface, contact_rotations
from skincal.model.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class Setting:
    """The skin's geometry, for effects that need it.

    Attributes:
        patch: the tactile points.
        surface: that carries them.
    """

    patch: Patch
    surface: Surface

    @property
    def taxels(self) -> int:
        """Number of taxels J."""
        return self.patch.layout.taxels

    @cached_property
    def centre_m(self) -> FloatArray:
        """(3,) centre of the taxels, on the surface [m]."""
        mean = self.patch.points_m[self.patch.taxel >= 0].mean(axis=0)
        return self.surface.project(mean[None])[0]

    @cached_property
    def axes(self) -> FloatArray:
        """(2, 3) unit vectors at the centre: across (towards growing beta) and along (+y)."""
        return contact_rotations(self.surface.normal_at(self.centre_m[None]))[0].T[:2]

    @cached_property
    def neighbours(self) -> FloatArray:
        """(J, J) one where two taxels are next to each other, else zero.

        No other taxel lies in or on the circle between their centres (Gabriel and Sokal 1969): in a grid those are the
        next in the row and the column, in a hexagonal layout the six round a taxel.
        """
        centres = self.patch.layout.centres_m
        square = ((centres[:, None] - centres) ** 2).sum(axis=-1)
        # A point lies in the circle where its squared distances from both ends are less than the diameter's square.
        between = square[:, None, :] + square[None, :, :] <= square[:, :, None] * (1 + 1e-6)
        ends = np.eye(self.taxels, dtype=bool)
        between &= ~(ends[:, None, :] | ends[None, :, :])
        return ((square > 0) & ~between.any(axis=-1)).astype(np.float64)

    @cached_property
    def same_row(self) -> FloatArray:
        """(J, J) one where two different taxels share a row, else zero."""
        row = np.arange(self.taxels) // self.patch.layout.cols
        return (row[:, None] == row) - np.eye(self.taxels)

    @cached_property
    def same_column(self) -> FloatArray:
        """(J, J) one where two different taxels share a column, else zero."""
        col = np.arange(self.taxels) % self.patch.layout.cols
        return (col[:, None] == col) - np.eye(self.taxels)

    @cached_property
    def elsewhere(self) -> FloatArray:
        """(J, J) one where two taxels share neither row nor column, else zero."""
        return 1.0 - np.eye(self.taxels) - self.same_row - self.same_column

    def moved(self, samples: Samples, across_m: FloatArray, along_m: FloatArray) -> Samples:
        """Return samples whose contacts are moved over the surface; a free object goes along without turning.

        Normals turn as the surface's own do from the old place to the new one.

        Args:
            samples: K of them.
            across_m: (K,) towards growing beta [m].
            along_m: (K,) along +y [m].
        """
        contacts = samples.contacts
        moves = samples.touching & np.isfinite(contacts.points_m).all(axis=1)
        moves &= np.isfinite(contacts.normals).all(axis=1) & ((across_m != 0) | (along_m != 0))
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
            origins = contacts.origins_m.copy()
            origins[moves] += new - old
            changes["origins_m"] = origins
        return replace(samples, contacts=replace(contacts, **changes))
