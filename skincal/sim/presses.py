"""Covariates of a session for a skin's effects, derived from the true contacts as they occur."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skincal.effects.samples import HOLD, IDLE, LOAD, UNLOAD
from skincal.model.arrays import FloatArray
from skincal.robot import Kinematics
from skincal.sim.touch import TrueContact

SITE_M = 1e-3
"""Largest distance of touches of one site [m]."""
POSE_RAD = 0.06
"""Largest difference in angles of the finger with the skin within one hand pose [rad]."""
APART_S = 0.2
"""Longest loss of contact within one press [s]."""
STEADY_N_PER_S = 0.4
"""Largest change of a force that counts as held [N/s]."""


@dataclass(frozen=True)
class Covariates:
    """Covariates of one sample; see :class:`skincal.effects.Samples`."""

    press: int
    phase: int
    speed_m_per_s: float
    cycle: float
    met_n: float
    pose: int


class PressTracker:
    """Tracker that numbers presses, counts earlier touches of a site, and detects poses and phases."""

    def __init__(self, kinematics: Kinematics) -> None:
        self._skin_joints = kinematics.skin.columns
        self._sites: list[FloatArray] = []
        self._peaks_n: list[float] = []
        self._poses: list[FloatArray] = []
        self._press = -1
        self._pose, self._cycle, self._met_n, self._speed = -1, 0, 0.0, float("nan")
        self._last: TrueContact | None = None
        self._closing_m_per_s = 0.0
        self._touched_s = -np.inf

    def next(self, contact: TrueContact) -> Covariates:
        """Return the covariates of the next sample."""
        if contact.touching and contact.time_s - self._touched_s > APART_S:
            self._begin(contact)
        phase = self._phase(contact)
        self._closing_m_per_s = self._change(contact, "gap_m", sign=-1.0)
        self._last = contact
        if not contact.touching:
            return Covariates(-1, IDLE, float("nan"), float("nan"), float("nan"), self._pose)
        self._touched_s = contact.time_s
        self._peaks_n[-1] = max(self._peaks_n[-1], contact.force_n)
        return Covariates(self._press, phase, self._speed, float(self._cycle), self._met_n, self._pose)

    def _begin(self, contact: TrueContact) -> None:
        """Start a press: record its site, earlier touches, pose and speed."""
        self._press += 1
        near = [np.linalg.norm(site - contact.point_m) < SITE_M for site in self._sites]
        self._cycle = int(np.sum(near))
        self._met_n = max((peak for peak, same in zip(self._peaks_n, near, strict=True) if same), default=0.0)
        self._sites.append(contact.point_m)
        self._peaks_n.append(0.0)
        angles = contact.q_rad[self._skin_joints]
        same = [i for i, pose in enumerate(self._poses) if np.abs(pose - angles).max() < POSE_RAD]
        if not same:
            self._poses.append(angles)
        self._pose = same[0] if same else len(self._poses) - 1
        # Use the speed before the touch: afterwards the skin slows the indenter down.
        self._speed = max(self._closing_m_per_s, 0.0)

    def _phase(self, contact: TrueContact) -> int:
        if not contact.touching:
            return IDLE
        change = self._change(contact, "force_n", sign=1.0)
        if abs(change) < STEADY_N_PER_S:
            return HOLD
        return LOAD if change > 0 else UNLOAD

    def _change(self, contact: TrueContact, name: str, sign: float) -> float:
        """Return the rate of change since the last sample; 0 at the first."""
        last = self._last
        if last is None or contact.time_s <= last.time_s:
            return 0.0
        return sign * float(getattr(contact, name) - getattr(last, name)) / (contact.time_s - last.time_s)
