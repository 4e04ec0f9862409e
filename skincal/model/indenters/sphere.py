"""A sphere, in closed form."""

from __future__ import annotations

import math
from typing import ClassVar

from skincal.model.indenters.indenter import MISSED, ClosedForm


class Sphere(ClosedForm):
    """A ball with its centre at (0, 0, radius): it touches the origin of its frame from above.

    Attributes:
        radius_m: radius [m].
        kind: see :class:`ClosedForm`.
        name: see :class:`ClosedForm`.
    """

    kind: ClassVar[int] = 0
    name: ClassVar[str] = "sphere"

    @property
    def depth_m(self) -> float:
        return self.radius_m


def meet(radius: float, frame: tuple[float, ...], x: float, y: float, z: float) -> tuple[float, float]:
    """Cast a ray along the contact normal from a point, and return the distance and facing of the hit.

    Scalar code without numpy, for compilation.

    Args:
        radius: radius of the indenter [m].
        frame: contact normal and the axes of the indenter's frame: 12 numbers.
        x: the point, relative to the origin of the indenter's frame, in the axes of the fingertip frame [m].
        y: the same.
        z: the same.

    Returns:
        Distance [m], inf without a hit, and facing max(-n_s . n_c, 0).
    """
    x -= radius * frame[9]
    y -= radius * frame[10]
    z -= radius * frame[11]
    along = x * frame[0] + y * frame[1] + z * frame[2]
    half_2 = along * along - (x * x + y * y + z * z) + radius * radius
    half = math.sqrt(max(half_2, 0.0))
    return -along - half if half_2 >= 0 else MISSED, half / radius


def paraboloid(radius: float, frame: tuple[float, ...]) -> tuple[float, float, float, float, float, float]:
    """See :func:`skincal.model.press.meet.paraboloid`. Relative to the centre, -sqrt(R² - r²) >= -R + r² / 2R."""
    return radius * frame[9], radius * frame[10], radius * frame[11], -radius, 0.5 / radius, radius
