"""A rigid flat punch, in closed form."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from skincal.model.arrays import FloatArray, as_floats, positive
from skincal.model.indenters.base import Indenter, RayHits
from skincal.model.indenters.bound import Bound, frames


@dataclass(frozen=True)
class FlatPunch(Indenter):
    """A rigid disc in the plane z = 0 of its frame, facing -z. Larger than the patch it stands for a pressure chamber.

    Attributes:
        radius_m: radius of the disc [m].
    """

    radius_m: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "radius_m", positive("flat punch radius_m", self.radius_m))

    def cast(self, origins_m: ArrayLike, direction: ArrayLike) -> RayHits:
        """See :meth:`Indenter.cast`. A ray along the disc misses it; the disc is met from either side."""
        origins = as_floats(origins_m)
        direction = np.broadcast_to(as_floats(direction), origins.shape)
        rise = direction[..., 2]
        crosses = rise != 0
        distance = -origins[..., 2] / np.where(crosses, rise, np.nan)
        where = origins[..., :2] + distance[..., None] * direction[..., :2]
        hit = crosses & (np.sum(where**2, axis=-1) <= self.radius_m**2)
        normals = np.zeros_like(origins)
        normals[..., 2] = -np.sign(rise)
        normals[~hit] = np.nan
        return RayHits(np.where(hit, distance, np.inf), normals)

    def bound(self, directions: FloatArray, contacts_m: FloatArray) -> Bound:
        """See :meth:`Indenter.bound`. About its centre; tilted by t its near edge is radius * sin t before it."""
        one = np.ones((len(directions), 1))
        lean = np.hypot(directions[:, 0], directions[:, 1])
        return Bound(
            axis_m=np.zeros_like(directions),
            frame=frames(directions, (1.0, 0.0, 0.0)),
            nearest_m=-self.radius_m * lean,
            bend_per_m=0.0 * one,
            reach_m=self.radius_m * one,
        )
