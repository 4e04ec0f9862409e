"""The plan of a session: presses in their order, each with its site, force, pace and hand pose."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

Kind = Literal["regular", "anchor", "repeat", "revisit"]

KINDS: tuple[Kind, ...] = get_args(Kind)
"""Purpose of a press: a site of its own; the anchor, which recurs throughout the session; an exact repeat of an earlier
press; a revisit of an earlier site in another way."""

Site = tuple[float, float]


@dataclass(frozen=True)
class PlannedPress:
    """A planned press.

    Attributes:
        u_m: site along u, in patch coordinates of the nominal mount [m].
        v_m: site along v [m].
        force_n: normal force of the hold [N].
        speed_m_per_s: speed of the commanded indenter along the normal while loading and unloading [m/s].
        hold_s: length of the hold [s].
        pose: name of the hand pose.
        kind: purpose of the press.
        indenter_radius_m: radius of the indenter's sphere [m]; None: the hand's own.
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
        """Site (u, v) [m]; presses of one site have exactly equal numbers."""
        return self.u_m, self.v_m

    def same_press(self, other: PlannedPress) -> bool:
        """Return whether another press equals this one in everything but its purpose."""
        return replace(self, kind=other.kind) == other


@dataclass(frozen=True)
class Plan:
    """The presses of a session.

    Attributes:
        name: name of the protocol, or of the file.
        presses: presses in their order; the index is the number of the press.
        poses: joint angles [rad] of the finger with the skin, by the pose's name. A pose without angles is
            searched for the hand when the session begins.
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
        """Force of the hardest press [N]."""
        return max(press.force_n for press in self.presses)

    def cycles(self) -> tuple[int, ...]:
        """Return the number of earlier touches of each press's site."""
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
        """Return the number of presses of a kind."""
        return sum(press.kind == kind for press in self.presses)
