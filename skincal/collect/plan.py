"""What a session shall do: presses in their order, each with its site, force, pace and hand pose."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

Kind = Literal["regular", "anchor", "repeat", "revisit"]

KINDS: tuple[Kind, ...] = get_args(Kind)
"""What a press is for: one of its own; the press that comes back all session long; an exact copy of an earlier one;
an earlier site pressed in another way."""

Site = tuple[float, float]


@dataclass(frozen=True)
class PlannedPress:
    """One press.

    Attributes:
        u_m: where, in patch coordinates of the nominal mount [m].
        v_m: the same [m].
        force_n: normal force of the hold [N].
        speed_m_per_s: speed of the commanded indenter along the normal while loading and unloading [m/s].
        hold_s: how long the force is held [s].
        pose: name of the hand pose.
        kind: what the press is for.
        indenter_radius_m: radius of the sphere that presses [m]; None: the hand's own.
    """

    u_m: float
    v_m: float
    force_n: float
    speed_m_per_s: float
    hold_s: float
    pose: str = "A"
    kind: Kind = "regular"
    indenter_radius_m: float | None = None

    @property
    def site(self) -> Site:
        """Where (u, v) [m]; two presses of one site have the very same numbers."""
        return self.u_m, self.v_m

    def same_press(self, other: PlannedPress) -> bool:
        """Whether the other press is this one over again: everything alike but what it is for."""
        return _content(self) == _content(other)


def _content(press: PlannedPress) -> tuple[object, ...]:
    pace = (press.force_n, press.speed_m_per_s, press.hold_s)
    return (*press.site, *pace, press.pose, press.indenter_radius_m)


@dataclass(frozen=True)
class Plan:
    """The presses of a session.

    Attributes:
        name: of the protocol, or of the file.
        presses: in their order; a press goes by its index.
        poses: angles [rad] of the joints of the finger with the skin, by the pose's name. A pose without angles is
            found for the hand when the session begins.
    """

    name: str
    presses: tuple[PlannedPress, ...]
    poses: Mapping[str, tuple[float, ...]] = field(default_factory=dict[str, tuple[float, ...]])

    def __len__(self) -> int:
        return len(self.presses)

    @property
    def pose_names(self) -> tuple[str, ...]:
        """Poses in the order of their first use."""
        return tuple(dict.fromkeys(press.pose for press in self.presses))

    @property
    def largest_force_n(self) -> float:
        """The hardest press [N]."""
        return max(press.force_n for press in self.presses)

    def cycles(self) -> tuple[int, ...]:
        """How often the site of each press has been touched before it."""
        touched: dict[Site, int] = {}
        cycles: list[int] = []
        for press in self.presses:
            cycles.append(touched.get(press.site, 0))
            touched[press.site] = cycles[-1] + 1
        return tuple(cycles)

    def sites_m(self) -> NDArray[np.float64]:
        """Return the patch coordinates of the presses, shape (K, 2) [m]."""
        return np.array([press.site for press in self.presses], dtype=np.float64).reshape(-1, 2)

    def count(self, kind: Kind) -> int:
        """How many presses are of a kind."""
        return sum(press.kind == kind for press in self.presses)
