"""A sphere, in closed form."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from skincal.model.arrays import FloatArray, as_floats, positive
from skincal.model.indenters.base import Indenter, RayHits
from skincal.model.indenters.bound import Bound, frames

_UP = (0.0, 0.0, 1.0)


@dataclass(frozen=True)
class Sphere(Indenter):
    """A ball that touches its frame's origin from above: its centre is (0, 0, radius).

    Attributes:
        radius_m: radius [m].
    """

    radius_m: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "radius_m", positive("sphere radius_m", self.radius_m))

    def cast(self, origins_m: ArrayLike, direction: ArrayLike) -> RayHits:
        """See :meth:`Indenter.cast`."""
        away = as_floats(origins_m) - [0.0, 0.0, self.radius_m]
        directions = np.broadcast_to(as_floats(direction), away.shape)
        along = np.einsum("...i,...i->...", away, directions)
        half_chord_2 = along**2 - (np.einsum("...i,...i->...", away, away) - self.radius_m**2)
        hit = half_chord_2 >= 0
        ahead = -along - np.sqrt(np.where(hit, half_chord_2, np.nan))
        normals = (away + ahead[..., None] * directions) / self.radius_m
        return RayHits(np.where(hit, ahead, np.inf), normals)

    def heights(
        self,
        origins_m: FloatArray,
        directions: FloatArray,
        bound: Bound,
        limit_m: FloatArray,
    ) -> tuple[FloatArray, FloatArray]:
        """See :meth:`Indenter.heights`. The surface faces the ray by half the chord over the radius."""
        along = (origins_m @ directions[:, :, None])[..., 0] - self.radius_m * directions[:, 2:]
        half_chord = along**2
        half_chord -= origins_m[..., 0] ** 2
        half_chord -= origins_m[..., 1] ** 2
        half_chord -= (origins_m[..., 2] - self.radius_m) ** 2
        half_chord += self.radius_m**2
        misses = half_chord < 0
        np.sqrt(np.maximum(half_chord, 0.0, out=half_chord), out=half_chord)
        distance = -along - half_chord
        distance[misses] = np.inf
        return distance, half_chord / self.radius_m

    def bound(self, directions: FloatArray, contacts_m: FloatArray) -> Bound:
        """See :meth:`Indenter.bound`. About its own centre: -sqrt(R² - r²) >= -R + r² / 2R."""
        del contacts_m
        if len(directions) == 1 and tuple(directions[0].tolist()) == _UP:
            return self._upright
        return self._paraboloid(directions)

    @cached_property
    def _upright(self) -> Bound:
        """The bound of a press without rotations."""
        return self._paraboloid(np.array([_UP]))

    def _paraboloid(self, directions: FloatArray) -> Bound:
        one = np.ones((len(directions), 1))
        return Bound(
            axis_m=one * [0.0, 0.0, self.radius_m],
            frame=frames(directions, (1.0, 0.0, 0.0)),
            nearest_m=-self.radius_m * one[:, 0],
            bend_per_m=one / (2 * self.radius_m),
            reach_m=self.radius_m * one,
        )
