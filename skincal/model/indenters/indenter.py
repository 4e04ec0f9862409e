"""Interface of indenters: how far away they are along a ray."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from skincal.model.arrays import FloatArray, as_floats

MISSED = math.inf
"""Distance to an indenter that a ray does not meet [m]."""


@dataclass(frozen=True, eq=False)
class RayHits:
    """Places where rays meet an indenter.

    Attributes:
        distance_m: (N,) signed distance [m] from each origin along its ray; inf where the ray misses.
        facing: (N,) cosine between the ray and the indenter's inward normal there; 0 where it misses.
    """

    distance_m: FloatArray
    facing: FloatArray


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
            origins_m: (N, 3) points [m].
            direction: (3,) unit vector.
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

    def cast(self, origins_m: ArrayLike, direction: ArrayLike) -> RayHits:
        from skincal.model.press.call import routine

        points, found = np.array(as_floats(origins_m).T, order="C"), np.empty((2, len(as_floats(origins_m))))
        routine().cast(self.kind, self.radius_m, np.array(direction, dtype=np.float64), points, *found)
        return RayHits(*found)
