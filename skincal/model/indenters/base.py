"""What an indenter must be able to do: say how far away it is along a ray."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from skincal.model.arrays import FloatArray
from skincal.model.indenters.bound import Bound


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
    """A rigid body that presses on the skin. Add a kind with one file beside this one.

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

    def along(self, origins_m: FloatArray, direction: FloatArray) -> tuple[FloatArray, FloatArray]:
        """What of :meth:`cast` the skin needs, for rays in one direction. A closed form may know a shorter way.

        Args:
            origins_m: (N, 3) points [m].
            direction: (3,) unit vector.

        Returns:
            Distances (N,) [m], and how far the surface there faces against the ray, max(-n_s . n_c, 0) (N,): zero
            where it misses.
        """
        hits = self.cast(origins_m, direction)
        faced = -(hits.normals @ direction)
        return hits.distance_m, np.where(faced > 0, faced, 0.0)

    def heights(
        self,
        origins_m: FloatArray,
        directions: FloatArray,
        bound: Bound,
        limit_m: FloatArray,
    ) -> tuple[FloatArray, FloatArray]:
        """What of :meth:`cast` the skin needs, for K batches of rays. A closed form may know a shorter way.

        Args:
            origins_m: (K, M, 3) points [m].
            directions: (K, 3) unit vectors, one for each batch.
            bound: what :meth:`bound` said of these directions.
            limit_m: (K,) distances [m] that matter: a greater one may be given as inf.

        Returns:
            Distances (K, M) [m], and how far the surface there faces against the ray, max(-n_s . n_c, 0) (K, M):
            zero where it misses.
        """
        place = bound.place(np.swapaxes(origins_m, 1, 2))
        near = bound.distance(place) <= limit_m[:, None]
        if not near.any():
            return np.full(near.shape, np.inf), np.zeros(near.shape)
        distance, facing = np.full(near.shape, np.inf), np.zeros(near.shape)
        along = np.broadcast_to(directions[:, None], origins_m.shape)[near]
        hits = self.cast(origins_m[near], along)
        faced = -np.einsum("ni,ni->n", hits.normals, along)
        distance[near], facing[near] = hits.distance_m, np.where(faced > 0, faced, 0.0)
        return distance, facing

    @property
    @abstractmethod
    def depth_m(self) -> float:
        """The penetration from which on a press makes no sense, as the indenter has sunk in [m]."""

    def bound(self, directions: FloatArray, contacts_m: FloatArray) -> Bound:
        """Where the indenter can be at most, seen along K directions, in its own frame.

        Args:
            directions: (K, 3) unit vectors.
            contacts_m: (K, 3) where it is thought to touch [m]; a hint for a tight bound, no more.
        """
        raise NotImplementedError


class ClosedForm(Indenter):
    """An indenter that the compiled routine knows in closed form, by one length.

    Attributes:
        radius_m: that length [m].
        kind: which of the closed forms (:mod:`skincal.model.press.meet`).
    """

    radius_m: float
    kind: ClassVar[int]
