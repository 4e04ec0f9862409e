"""One press: approach, load, hold at a regulated force, unload, lift."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from skincal.collect.loop import Loop
from skincal.collect.options import CollectOptions
from skincal.collect.plan import PlannedPress
from skincal.collect.posture import Posture
from skincal.collect.samples import Sample

FloatArray = NDArray[np.float64]

Status = Literal["ok", "missed_target", "slipped", "lost_contact", "no_contact"]

NEAR_M = 0.0025
"""Below this height the approach is slow [m]: the skin may begin anywhere from here, as joints are off."""

FAST = 5.0
"""How many times as fast the approach is above, and the lift after the skin is left."""

TRIM_BOUND_RAD = 0.05
"""Largest correction of a commanded angle for what a joint is off in free motion [rad]."""

FORCE_BOUND = 1.5
"""The commanded force stays below this times the target, and 1 N: beyond it regulation does more harm than good."""


@dataclass
class Moments:
    """When the parts of a press began, session clock [s]; NaN: they did not come."""

    start_s: float = float("nan")
    hold_s: float = float("nan")
    release_s: float = float("nan")
    end_s: float = float("nan")


@dataclass
class _Force:
    """The regulated force, and its measured value through a low-pass."""

    measured_n: float = 0.0
    command_n: float = 0.0
    sum_n: float = field(default=0.0)


class Press:
    """Makes one press; the hand stands above the site at the posture's greatest height.

    Args:
        loop: the hand.
        posture: over the site.
        planned: what is to be done.
        options: how.
        trim_rad: correction of the commanded angles that the hand now has (n,) [rad].
    """

    def __init__(
        self,
        loop: Loop,
        posture: Posture,
        planned: PlannedPress,
        options: CollectOptions,
        trim_rad: FloatArray,
    ) -> None:
        self._loop, self._posture, self._planned, self._options = loop, posture, planned, options
        self._trim = trim_rad.copy()
        self._height_m = float(posture.heights_m[-1])
        self._force = _Force()
        self._share = loop.period_s / (options.filter_s + loop.period_s)
        self.moments = Moments()
        self.lost = False

    @property
    def trim_rad(self) -> FloatArray:
        """What the commanded angles now are off from those of the posture at its greatest height (n,) [rad]."""
        return self._command() - self._posture.links_at(self._height_m)

    def run(self) -> Moments:
        """Makes the press.

        Returns:
            When its parts began. The samples are in the loop.
        """
        self._still()
        if self._approach():
            self._load()
            self._hold()
            self._unload()
        self._lift()
        return self.moments

    def _step(self) -> Sample:
        sample = self._loop.step(self._command())
        self._force.measured_n += self._share * (sample.force_n - self._force.measured_n)
        return sample

    def _command(self) -> FloatArray:
        return self._posture.command(self._height_m, self._force.command_n) + self._trim

    def _still(self) -> None:
        """Waits above the site until the fingers rest there, and takes the torques at rest."""
        self._loop.doing = "idle"
        steps = self._loop.steps(self._options.still_s)
        seen: list[Sample] = []
        for _ in range(2 * steps):
            seen.append(self._step())
            self._correct(seen[-1])
        self._loop.senses.take_tare(seen[steps:])
        self._force.measured_n = 0.0

    def _correct(self, sample: Sample) -> None:
        """Moves the commanded angles on until the measured ones are right; nothing touches yet."""
        off = self._posture.links_at(self._height_m) - sample.links_rad
        step = self._options.trim_per_s * self._loop.period_s
        self._trim = np.clip(self._trim + step * off, -TRIM_BOUND_RAD, TRIM_BOUND_RAD)

    def _approach(self) -> bool:
        """Goes down until the skin is felt; False: it was not found."""
        options, period = self._options, self._loop.period_s
        felt = 0
        self._loop.doing = "approach"
        while self._height_m > self._posture.heights_m[0]:
            speed = options.approach_m_per_s * (FAST if self._height_m > NEAR_M else 1.0)
            self._height_m -= speed * period
            sample = self._step()
            felt = felt + 1 if self._force.measured_n > options.contact_n else 0
            if felt >= self._loop.steps(options.contact_s):
                self.moments.start_s = sample.time_s - options.before_s
                return True
        return False

    def _load(self) -> None:
        """Raises the force to the target at the planned speed of the commanded indenter."""
        self._loop.doing = "load"
        target, force = self._planned.force_n, self._force
        rate = self._posture.stiffness_n_per_m * self._planned.speed_m_per_s
        reference, first = force.measured_n, force.measured_n
        while abs(reference - target) > 1e-9:
            step = rate * self._loop.period_s
            reference = float(np.clip(target, reference - step, reference + step))
            self._regulate(reference, reference - first)
            if self._step() and self._slack(target):
                break
        self._feed = target - first
        near = max(self._options.tolerance_n, self._options.tolerance_share * target)
        for _ in range(self._loop.steps(self._options.reach_s)):
            if abs(force.measured_n - target) < near / 2:
                break
            self._regulate(target, self._feed)
            self._step()

    def _slack(self, target: float) -> bool:
        """Whether the ramp has ended though the force is far away: then the rest is for the regulation."""
        return self._force.command_n >= FORCE_BOUND * target + 1.0

    def _regulate(self, reference_n: float, feed_n: float) -> None:
        """Commands the force that the fingers should give, and what experience adds to it."""
        force = self._force
        error = reference_n - force.measured_n
        force.sum_n += self._options.regulate_per_s * self._loop.period_s * error
        bound = FORCE_BOUND * self._planned.force_n + 1.0
        force.sum_n = float(np.clip(force.sum_n, -bound - feed_n, bound - feed_n))
        force.command_n = feed_n + force.sum_n

    def _hold(self) -> None:
        self._loop.doing = "hold"
        self.moments.hold_s = self._loop.now.time_s
        lost_below = self._options.lost_share * self._planned.force_n
        for _ in range(self._loop.steps(self._planned.hold_s)):
            self._regulate(self._planned.force_n, self._feed)
            self._step()
            if self._force.measured_n < lost_below:
                self.lost = True
                break
        self.moments.release_s = self._loop.now.time_s

    def _unload(self) -> None:
        """Takes the force away at the planned speed, until the indenter leaves the skin."""
        self._loop.doing = "unload"
        force = self._force
        step = self._posture.stiffness_n_per_m * self._planned.speed_m_per_s * self._loop.period_s
        lowest = force.command_n - force.measured_n - self._posture.stiffness_n_per_m * NEAR_M
        while force.measured_n > self._options.contact_n / 2 and force.command_n > lowest:
            force.command_n -= step
            self._step()
        self.moments.end_s = self._loop.now.time_s + self._options.before_s

    def _lift(self) -> None:
        """Raises the indenter to the height at which it travels, and waits there."""
        top = float(self._posture.heights_m[-1])
        fast = FAST * self._options.approach_m_per_s * self._loop.period_s
        if np.isnan(self.moments.end_s):
            self._loop.doing = "idle"
        while self._height_m < top:
            self._height_m = min(self._height_m + fast, top)
            sample = self._step()
            if sample.time_s > self.moments.end_s:
                self._loop.doing = "idle"
        self._loop.doing = "idle"
        for _ in range(self._loop.steps(self._options.idle_s)):
            self._step()
