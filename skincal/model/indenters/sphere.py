"""A sphere, in closed form."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from skincal.model.arrays import positive
from skincal.model.indenters.indenter import MISSED, ClosedForm


@dataclass(frozen=True)
class Sphere(ClosedForm):
    """A ball that touches its frame's origin from above: its centre is (0, 0, radius)."""

    radius_m: float
    kind: ClassVar[int] = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "radius_m", positive("sphere radius_m", self.radius_m))

    @property
    def depth_m(self) -> float:
        return self.radius_m


def meet(radius: float, frame: tuple[float, ...], x: float, y: float, z: float) -> tuple[float, float]:
    """Return the distance along the contact normal at which a point meets the indenter, and how far that faces it.

    Compiled: scalar code, no numpy.

    Returns:
        Distance [m], inf where it misses, and max(-n_s . n_c, 0).
    """
    x -= radius * frame[9]
    y -= radius * frame[10]
    z -= radius * frame[11]
    along = x * frame[0] + y * frame[1] + z * frame[2]
    half_2 = along * along - (x * x + y * y + z * z) + radius * radius
    half = math.sqrt(max(half_2, 0.0))
    return -along - half if half_2 >= 0 else MISSED, half / radius


def paraboloid(radius: float, frame: tuple[float, ...]) -> tuple[float, float, float, float, float, float]:
    """See :func:`skincal.model.press.meet.paraboloid`. About its own centre: -sqrt(R² - r²) >= -R + r² / 2R."""
    return radius * frame[9], radius * frame[10], radius * frame[11], -radius, 0.5 / radius, radius
