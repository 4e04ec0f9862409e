"""The plan of a session: presses in their order, each with its site, force, pace and hand pose; options of a press."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from skincal.errors import check_options

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


@dataclass(frozen=True)
class CollectOptions:
    """Options of the press controller; times are on the hand's clock.

    Attributes:
        frame_rate_hz: largest rate of stored frames [Hz].
        clearance_m: height of the indenter above the skin while it travels [m].
        travel_m_per_s: largest speed of travel [m/s].
        travel_rad_per_s: largest speed of a joint during travel [rad/s].
        still_s: pause above the site, in which the torques at rest are measured [s].
        trim_per_s: rate at which the commanded angles are corrected until the measured ones are right, while nothing
            touches [1/s].
        approach_m_per_s: speed of the approach [m/s].
        touch_n_per_s: largest growth of the force when the skin is found; stiff fingers approach more slowly [N/s].
        search_m: depth below the skin's nominal surface at which the approach is given up [m].
        filter_s: time constant of the low-pass on the measured force [s].
        contact_n: force that counts as contact [N].
        contact_s: time for which the force must be above `contact_n` [s].
        near_m: height below which the approach is slow while the start of the skin is unknown [m].
        before_contact_m: the same, above the height at which earlier presses of a pose found the skin [m].
        regulate_share: proportional gain of the force error.
        regulate_per_s: integral gain of the force error [1/s].
        ease_s: time constant at the end of a force ramp [s].
        reach_s: longest time after the ramp for the force to come within the tolerance, before the hold begins [s].
        settle_s: first part of the hold, which is left out of a press's means [s].
        tolerance_n: a press whose mean force is off by more has missed its target, if it is also off by more than
            `tolerance_share` [N].
        tolerance_share: the same, relative to the target.
        slip_m: a contact point that moves more than this along the skin from the start of the hold has slipped [m].
        lost_share: contact is lost if the force in the hold falls below this part of the target.
        before_s: frames this long before the contact was detected belong to the loading [s].
        idle_s: pause after each press, at travelling height [s].
        rest_s: pause before the first press and after the last [s].
        reserve: largest torque of a press, relative to the joints' limits.
    """

    frame_rate_hz: float = 25.0
    clearance_m: float = 0.004
    travel_m_per_s: float = 0.1
    travel_rad_per_s: float = 1.5
    still_s: float = 0.1
    trim_per_s: float = 10.0
    approach_m_per_s: float = 0.006
    touch_n_per_s: float = 1.5
    search_m: float = 0.004
    filter_s: float = 0.015
    contact_n: float = 0.1
    contact_s: float = 0.02
    near_m: float = 0.002
    before_contact_m: float = 0.0008
    regulate_share: float = 1.0
    regulate_per_s: float = 15.0
    ease_s: float = 0.06
    reach_s: float = 0.4
    settle_s: float = 0.15
    tolerance_n: float = 0.05
    tolerance_share: float = 0.05
    slip_m: float = 0.001
    lost_share: float = 0.25
    before_s: float = 0.08
    idle_s: float = 0.16
    rest_s: float = 1.0
    reserve: float = 0.9

    def __post_init__(self) -> None:
        check_options(self, "a number above 0", lambda value: value > 0)
