"""Interface of indenters: ray casting and the valid depth."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike

from skincal.model.arrays import FloatArray, as_floats, positive

MISSED = math.inf
"""Distance along a ray that misses the indenter [m]."""


@dataclass(frozen=True, eq=False)
class RayHits:
    """Hits of N rays on an indenter.

    Attributes:
        distance_m: (N,) signed distance [m] from each origin along its ray; inf where the ray misses.
        facing: (N,) cosine between the ray and the indenter's inward normal at the hit; 0 where the ray misses.
    """

    distance_m: FloatArray
    facing: FloatArray


class Indenter(ABC):
    """A rigid body that presses on the skin: a closed form or a mesh.

    In its frame, +z is the contact normal n_c (out of the fingertip, into the indenter) and the origin is the contact
    point. A free object may use any other frame (see :class:`skincal.model.Contacts`).

    Attributes:
        radius_m: its size [m]; of a mesh half the shortest side of its bounding box.
    """

    radius_m: float

    @abstractmethod
    def cast(self, origins_m: ArrayLike, direction: ArrayLike) -> RayHits:
        """Cast rays at the indenter, in its own frame (paper, section II-A, on local penetrations).

        A ray is the whole line, traversed from minus infinity: the first hit may lie behind the origin, at a negative
        distance. The paper's shift of the origins by -D n_c, to start outside the indenter, is therefore not needed.

        Args:
            origins_m: (N, 3) points [m].
            direction: (3,) unit vector.
        """

    @abstractmethod
    def resized(self, factor: float) -> Indenter:
        """Return the indenter with all lengths multiplied; the contact point stays where it is."""

    @property
    @abstractmethod
    def depth_m(self) -> float:
        """The largest valid penetration [m]; beyond it the indenter has sunk in."""


@dataclass(frozen=True)
class ClosedForm(Indenter):
    """An indenter with a closed form in the compiled routine, described by one length.

    Attributes:
        radius_m: the length [m].
        kind: number of the closed form (``skincal.model.press.meet``).
        name: name of the shape, for errors.
    """

    radius_m: float
    kind: ClassVar[int]
    name: ClassVar[str]

    def __post_init__(self) -> None:
        object.__setattr__(self, "radius_m", positive(f"{self.name} radius_m", self.radius_m))

    def resized(self, factor: float) -> Self:
        return type(self)(factor * self.radius_m)

    def cast(self, origins_m: ArrayLike, direction: ArrayLike) -> RayHits:
        from skincal.model.press.call import routine

        points, found = np.array(as_floats(origins_m).T, order="C"), np.empty((2, len(as_floats(origins_m))))
        routine().cast(self.kind, self.radius_m, np.array(direction, dtype=np.float64), points, *found)
        return RayHits(*found)
