"""The bolt as the skin feels it: a mesh, and where it can be at most."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from skincal.model import Bound, MeshIndenter
from skincal.model.indenters.bound import frames

FloatArray = NDArray[np.float64]

_LEAST_ACROSS = 0.1
"""Seen more along its axis than this (sine), the bolt has no tighter bound than any mesh has."""
_WIDER = 1 + 1e-9
"""Rounding must not leave out a point at the very rim."""


@dataclass(frozen=True)
class BoltShape:
    """Lengths of a bolt along +x of its frame.

    Attributes:
        radius_m: of the shank [m].
        start_m: x of the shank's end [m].
        head_m: x at which the head begins [m].
        end_m: x at which it ends [m].
        head_radius_m: out to the corners of the head [m].
    """

    radius_m: float
    start_m: float
    head_m: float
    end_m: float
    head_radius_m: float


@dataclass(frozen=True, eq=False)
class LeaningBound(Bound):
    """A bound for long things that lean: exact for a shank, wherever along it one looks.

    With s along the shank, seen along the direction, and w beside it, no point of the shank is nearer than
    s tan(lean) - sqrt(r² - w²) / cos(lean), and none of the head than the same with the head's radius. The other
    attributes are those of a bound that always holds.

    Attributes:
        shape: the bolt.
        slope: (K,) tangent of the lean; infinite where nothing tighter is known.
        foreshortened: (K,) cosine of the lean.
    """

    shape: BoltShape
    slope: FloatArray
    foreshortened: FloatArray

    def __getitem__(self, rows: object) -> LeaningBound:
        """The bounds of some directions."""
        part = super().__getitem__(rows)  # type: ignore[arg-type]
        return self._with(part, self.slope[rows], self.foreshortened[rows])  # type: ignore[index]

    def moved(self, rotations: FloatArray, origins_m: FloatArray) -> LeaningBound:
        """See :meth:`Bound.moved`."""
        return self._with(super().moved(rotations, origins_m), self.slope, self.foreshortened)

    def _with(self, part: Bound, slope: FloatArray, short: FloatArray) -> LeaningBound:
        values = (part.axis_m, part.frame, part.nearest_m, part.bend_per_m, part.reach_m)
        return LeaningBound(*values, self.shape, slope, short)

    def distance(
        self, place_m: FloatArray, slack_m: FloatArray | None = None, along_m: FloatArray | None = None
    ) -> FloatArray:
        """See :meth:`Bound.distance`."""
        along, aside, ahead = place_m[:, 0], np.abs(place_m[:, 1]), place_m[:, 2]
        slack = 0.0 if slack_m is None else slack_m
        ahead = ahead + (slack if along_m is None else along_m)
        shape, slope, short = self.shape, self.slope[:, None], self.foreshortened[:, None]
        # A ball of points may lie higher on the slope by its radius; it may reach nearer to the middle as well.
        level = along * slope - ahead - slack * np.abs(slope)
        beside = np.maximum(aside - slack, 0.0)
        room_2 = shape.radius_m**2 - beside**2
        distance = level - np.sqrt(np.maximum(room_2, 0.0)) / short
        distance[room_2 < 0] = np.inf
        head = along + slack >= shape.head_m * short - shape.head_radius_m * short * np.abs(slope)
        if head.any():
            wide_2 = shape.head_radius_m**2 - beside**2
            nearer = level - np.sqrt(np.maximum(wide_2, 0.0)) / short
            nearer[wide_2 < 0] = np.inf
            distance = np.where(head, nearer, distance)
        return distance


class BoltIndenter(MeshIndenter):
    """A bolt's mesh; its rays are spared by what is known of its shape.

    Args:
        vertices_m: (V, 3) vertices [m].
        faces: (F, 3) indices of vertices.
        shape: encloses the mesh.
    """

    def __init__(self, vertices_m: FloatArray, faces: NDArray[np.int64], shape: BoltShape) -> None:
        super().__init__(vertices_m, faces)
        self._shape = replace(
            shape, radius_m=_WIDER * shape.radius_m, head_radius_m=_WIDER * shape.head_radius_m
        )

    def bound(self, directions: FloatArray, contacts_m: FloatArray) -> Bound:
        """See :meth:`Indenter.bound`."""
        lean, shape = directions[:, 0], self._shape
        across: FloatArray = np.sqrt(np.maximum(1 - lean**2, 0.0))
        if not (across > _LEAST_ACROSS).all():
            return super().bound(directions, contacts_m)
        one = np.ones((len(directions), 1))
        longest = max(-shape.start_m, shape.end_m) + shape.head_radius_m
        return LeaningBound(
            axis_m=np.zeros_like(directions),
            frame=frames(directions, (1.0, 0.0, 0.0)),
            nearest_m=-longest * one[:, 0],
            bend_per_m=0.0 * one,
            reach_m=longest * one,
            shape=shape,
            slope=lean / across,
            foreshortened=across,
        )
