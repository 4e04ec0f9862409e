"""What an indenter must be able to do: say how far away it is along a ray."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

from numpy.typing import ArrayLike

from skincal.model.arrays import FloatArray

MISSED = math.inf
"""Distance to an indenter that a ray does not meet [m]."""


@dataclass(frozen=True, eq=False)
class RayHits:
    """Where rays meet an indenter.

    Attributes:
        distance_m: (N,) signed distance [m] from each origin along its ray; inf where the ray misses.
        normals: (N, 3) outward unit normals of the indenter there (against the ray); NaN where it misses.
    """

    distance_m: FloatArray
    normals: FloatArray


class Indenter(ABC):
    """A rigid body that presses on the skin: a closed form, one file each, or a mesh.

    Its own frame: +z is the contact normal n_c (out of the fingertip, into the indenter), the origin is the
    contact point. A free object may use any other frame (see :class:`skincal.model.Contacts`).
    """

    @abstractmethod
    def cast(self, origins_m: ArrayLike, direction: ArrayLike) -> RayHits:
        """Cast rays at the indenter, in its own frame (paper, section II-A, on local penetrations).

        The whole line counts, coming from minus infinity: the first surface it meets may lie behind the origin,
        and the distance is then negative. So the paper's shift by -D n_c is not needed, which serves to start
        outside.

        Args:
            origins_m: (N, 3) points [m], or any shape (..., 3).
            direction: unit vector (3,), or any shape that broadcasts to the origins'.

        Returns:
            Distances (N,) and normals (N, 3) of the first surface that each line meets.
        """

    @property
    @abstractmethod
    def depth_m(self) -> float:
        """The penetration from which on a press makes no sense, as the indenter has sunk in [m]."""


class ClosedForm(Indenter):
    """An indenter that the compiled routine knows in closed form, by one length.

    Attributes:
        radius_m: that length [m].
        kind: which of the closed forms (``skincal.model.press.meet``).
    """

    radius_m: float
    kind: ClassVar[int]
