"""A rigid flat punch, in closed form."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from skincal.model.arrays import as_floats, positive
from skincal.model.indenters.indenter import MISSED, ClosedForm, RayHits


@dataclass(frozen=True)
class FlatPunch(ClosedForm):
    """A rigid disc in the plane z = 0 of its frame, facing -z. Larger than the patch it stands for a pressure chamber.

    Attributes:
        radius_m: radius of the disc [m].
    """

    radius_m: float
    kind: ClassVar[int] = 1

    def __post_init__(self) -> None:
        object.__setattr__(self, "radius_m", positive("flat punch radius_m", self.radius_m))

    @property
    def depth_m(self) -> float:
        """See :attr:`Indenter.depth_m`. Its back is not part of it."""
        return math.inf

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


def meet(radius: float, frame: tuple[float, ...], x: float, y: float, z: float) -> tuple[float, float]:
    """Distance and facing: see :func:`skincal.model.indenters.sphere.meet`."""
    nx, ny, nz, ex, ey, ez = frame[0], frame[1], frame[2], frame[9], frame[10], frame[11]
    rise = ex * nx + ey * ny + ez * nz
    distance = -(x * ex + y * ey + z * ez) / (rise if rise != 0 else 1.0)
    x += distance * nx
    y += distance * ny
    z += distance * nz
    hit = rise != 0 and x * x + y * y + z * z <= radius * radius
    return distance if hit else MISSED, abs(rise)


def paraboloid(radius: float, frame: tuple[float, ...]) -> tuple[float, float, float, float, float, float]:
    """See :func:`skincal.model.press.meet.paraboloid`. Tilted by t its edge is radius * sin t before it."""
    rise = frame[0] * frame[9] + frame[1] * frame[10] + frame[2] * frame[11]
    return 0.0, 0.0, 0.0, -radius * math.sqrt(max(1.0 - rise * rise, 1e-15)), 0.0, radius
