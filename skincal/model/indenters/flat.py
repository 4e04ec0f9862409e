"""A rigid flat punch, in closed form."""

from __future__ import annotations

import math
from typing import ClassVar

from skincal.model.indenters.indenter import MISSED, ClosedForm


class FlatPunch(ClosedForm):
    """A rigid disc in the plane z = 0 of its frame, facing -z. A disc larger than the patch acts as a pressure chamber.

    Attributes:
        radius_m: radius of the disc [m].
        kind: see :class:`ClosedForm`.
        name: see :class:`ClosedForm`.
    """

    kind: ClassVar[int] = 1
    name: ClassVar[str] = "flat punch"

    @property
    def depth_m(self) -> float:
        """See :attr:`Indenter.depth_m`; a punch has no back, so that any penetration is valid."""
        return math.inf


def meet(radius: float, frame: tuple[float, ...], x: float, y: float, z: float) -> tuple[float, float]:
    """Return distance and facing: see :func:`skincal.model.indenters.sphere.meet`."""
    nx, ny, nz, ex, ey, ez = frame[0], frame[1], frame[2], frame[9], frame[10], frame[11]
    rise = ex * nx + ey * ny + ez * nz
    distance = -(x * ex + y * ey + z * ez) / (rise if rise != 0 else 1.0)
    x += distance * nx
    y += distance * ny
    z += distance * nz
    hit = rise != 0 and x * x + y * y + z * z <= radius * radius
    return distance if hit else MISSED, abs(rise)


def paraboloid(radius: float, frame: tuple[float, ...]) -> tuple[float, float, float, float, float, float]:
    """See :func:`skincal.model.press.meet.paraboloid`. At a tilt t the nearest point lies radius * sin t ahead."""
    rise = frame[0] * frame[9] + frame[1] * frame[10] + frame[2] * frame[11]
    return 0.0, 0.0, 0.0, -radius * math.sqrt(max(1.0 - rise * rise, 1e-15)), 0.0, radius
