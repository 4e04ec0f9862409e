"""One press: approach, load, hold at a regulated force, unload, lift; the force regulator."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from skincal.collect.force_checks import BLIND_M, BLIND_S, ApproachCheck, ForceGrowth
from skincal.collect.plan import CollectOptions, PlannedPress
from skincal.collect.posture import Posture
from skincal.collect.senses import Loop, Sample
from skincal.model.arrays import FloatArray


class Regulator:
    """Proportional-integral controller of the force, for fingers with stick friction in their joints.

    The command is the force that the fingers would give by their stiffness alone. Stick friction takes some of it, more
    when the motion reverses, and lets shear grow; both show in the measured torques and are regulated to zero.

    Args:
        period_s: time between two steps [s].
        filter_s: time constant of the low-pass on the measured force [s].
        lag_s: lag of the force behind the command, before that low-pass [s].
        share: proportional gain.
        per_s: integral gain [1/s].
    """

    def __init__(self, period_s: float, filter_s: float, lag_s: float, share: float, per_s: float) -> None:
        self._smooth = period_s / (filter_s + period_s)
        self._follow = period_s / (filter_s + lag_s + period_s)
        self._share, self._gain = share, per_s * period_s
        self._sum: FloatArray = np.zeros(3)
        self._start: FloatArray = np.zeros(3)
        self._expected: FloatArray = np.zeros(3)
        self.measured_n: FloatArray = np.zeros(3)
        self.command_n: FloatArray = np.zeros(3)

    @property
    def normal_n(self) -> float:
        """The smoothed normal force [N]."""
        return float(self.measured_n[0])

    def measure(self, sample: Sample) -> None:
        """Add a measurement."""
        force = (sample.force_n, sample.shear_u_n, sample.shear_v_n)
        self.measured_n = self.measured_n + self._smooth * (np.array(force) - self.measured_n)

    def begin(self) -> None:
        """Start at the present force, as that of the present command."""
        self._start = self.measured_n.copy()
        self._start[1:] = 0.0
        self._expected = self._start.copy()
        self._sum = np.zeros(3)

    def regulate(self, normal_n: float, bound_n: float) -> None:
        """Compute the next command.

        The measured force is compared with the force expected by now without friction. Otherwise a ramp would fill the
        integral, and the force would overshoot its target.
        """
        reference = np.array([normal_n, 0.0, 0.0])
        self._expected = self._expected + self._follow * (reference - self._expected)
        error = self._expected - self.measured_n
        self._sum = np.clip(self._sum + self._gain * error, -bound_n, bound_n)
        command = reference - self._start + self._share * error + self._sum
        self.command_n = np.clip(command, -bound_n, bound_n)


Status = Literal["ok", "missed_target", "slipped", "lost_contact", "no_contact"]

FAST = 5.0
"""Factors by which the approach is faster far from the skin, and the lift faster after it has left the skin."""

TRIM_BOUND_RAD = 0.08
"""Largest correction of a commanded angle for a joint's error in free motion [rad]."""

STILL_RAD = 2e-3
"""Joints rest when their mean angles are within this of their targets [rad]."""

NEARLY_N = 0.02
"""A ramp ends this close to its target [N]."""

SPARE_N = 4.0
"""Largest excess of the commanded force over that of the press, for sticking joints [N]."""

SENSOR, POSITIVE = "joint torques", "a positive torque accelerates a joint towards growing angles"
"""Name and sign of the force sensors, for errors."""


@dataclass
class Moments:
    """Start of each part of a press, session clock [s]; NaN: it did not happen."""

    start_s: float = float("nan")
    hold_s: float = float("nan")
    release_s: float = float("nan")
    end_s: float = float("nan")


class Press:
    """Executor of one press; the hand stands above the site at the posture's largest height."""

    def __init__(
        self, loop: Loop, posture: Posture, planned: PlannedPress, options: CollectOptions, near_m: float
    ) -> None:
        self._loop, self._posture, self._planned, self._options = loop, posture, planned, options
        self._near_m = near_m
        self._trim = np.zeros_like(posture.torque_m)
        self._height_m = self._reached_m = float(posture.heights_m[-1])
        gains = loop.rig.description.gains
        low_pass_s = 1 / (2 * np.pi * gains.low_pass_hz)
        self._lag_s = float(np.mean(gains.damping_nms_per_rad / gains.stiffness_nm_per_rad)) + low_pass_s
        self._regulator = Regulator(
            loop.period_s, options.filter_s, low_pass_s + loop.period_s, options.regulate_share, options.regulate_per_s
        )  # fmt: skip
        self._bound_n = planned.force_n + SPARE_N
        # Of the measured way, as angles and torques have one time.
        self._growth = ForceGrowth(SENSOR, options.contact_n, BLIND_M)
        self.moments = Moments()
        self.found_m = float("nan")
        self.lost = False

    @property
    def offset_rad(self) -> FloatArray:
        """Offset of the commanded angles from those of the posture at its present height (n,) [rad]."""
        return self._command() - self._posture.links_at(self._height_m)

    def run(self) -> Moments:
        """Make the press; return the starts of its parts. The samples are in the loop."""
        self._still()
        if self._approach():
            self._load()
            self._hold()
            self._loop.doing = "unload"
            self._ramp(self._regulator.normal_n, 0.0)
        self._lift()
        return self.moments

    def _step(self) -> Sample:
        sample = self._loop.step(self._command())
        self._regulator.measure(sample)
        return sample

    def _command(self) -> FloatArray:
        return self._posture.command(self._height_m, self._regulator.command_n) + self._trim

    def _still(self) -> None:
        """Wait above the site until the fingers rest there, and measure the torques at rest."""
        self._loop.doing = "idle"
        steps = self._loop.steps(self._options.still_s)
        samples: list[Sample] = []
        off = np.inf
        while len(samples) < steps or (off > STILL_RAD and len(samples) < 4 * steps):
            samples.append(self._step())
            self._correct(samples[-1])
            links = np.mean([sample.links_rad for sample in samples[-steps:]], axis=0)
            off = float(np.abs(self._posture.links_at(self._height_m) - links).max())
        self._loop.senses.take_tare(samples[-steps:])
        self._regulator.measured_n = np.zeros(3)

    def _correct(self, sample: Sample) -> None:
        """Adjust the commanded angles until the measured ones are right, before anything touches.

        They are right where a hand without friction, which lags behind its commands, would be by now.
        """
        share = self._loop.period_s / (self._lag_s + self._loop.period_s)
        self._reached_m += share * (self._height_m - self._reached_m)
        off = self._posture.links_at(self._reached_m) - sample.links_rad
        step = self._options.trim_per_s * self._loop.period_s
        self._trim = np.clip(self._trim + step * off, -TRIM_BOUND_RAD, TRIM_BOUND_RAD)

    def _approach(self) -> bool:
        """Lower the indenter until it feels the skin; return False if it was not found."""
        options, period = self._options, self._loop.period_s
        touching = 0
        self._loop.doing = "approach"
        fast = FAST * options.approach_m_per_s
        slow = min(options.approach_m_per_s, options.touch_n_per_s / self._posture.stiffness_n_per_m)
        # The commanded indenter's way, of which soft fingers take a part.
        blind_m = BLIND_M + BLIND_S * slow + 2 * options.contact_n / self._posture.stiffness_n_per_m
        free = [sample.state.taxels for sample in self._loop.samples]
        meta = self._loop.rig.description.meta
        check = ApproachCheck(SENSOR, meta, free, options.contact_n, blind_m, POSITIVE)
        while self._height_m > self._posture.heights_m[0]:
            self._height_m -= (fast if self._height_m > self._near_m else slow) * period
            sample = self._step()
            touching = touching + 1 if self._regulator.normal_n > options.contact_n else 0
            check.check(self._regulator.normal_n, self._height_m, sample.state.taxels)
            if touching == 0:
                self._correct(sample)
            if touching >= self._loop.steps(options.contact_s):
                self.moments.start_s = sample.time_s - options.before_s
                self.found_m = self._height_m
                return True
        return False

    def _load(self) -> None:
        """Raise the force to the target at the planned speed of the commanded indenter."""
        self._loop.doing = "load"
        target, regulator = self._planned.force_n, self._regulator
        regulator.begin()
        self._ramp(regulator.normal_n, target)
        near = max(self._options.tolerance_n, self._options.tolerance_share * target)
        for _ in range(self._loop.steps(self._options.reach_s)):
            if abs(regulator.normal_n - target) < near / 2:
                break
            self._regulated(target)

    def _ramp(self, begin_n: float, end_n: float) -> None:
        """Ramp the force from one value to another, gently at the end of a rise: sticking joints keep any overshoot."""
        rate = self._posture.stiffness_n_per_m * self._planned.speed_m_per_s
        period, force = self._loop.period_s, begin_n
        while abs(end_n - force) > NEARLY_N:
            gentle = max(abs(end_n - force), NEARLY_N) / self._options.ease_s
            step = (min(rate, gentle) if end_n > 0 else rate) * period
            force += float(np.clip(end_n - force, -step, step))
            self._regulated(force)

    def _regulated(self, force_n: float) -> None:
        self._regulator.regulate(force_n, self._bound_n)
        sample = self._step()
        if self._loop.doing == "load":
            self._growth.check(self._regulator.normal_n, sample.height_m)

    def _hold(self) -> None:
        self._loop.doing = "hold"
        self.moments.hold_s = self._loop.now.time_s
        lost_below = self._options.lost_share * self._planned.force_n
        for _ in range(self._loop.steps(self._planned.hold_s)):
            self._regulated(self._planned.force_n)
            if self._regulator.normal_n < lost_below:
                self.lost = True
                break
        self.moments.release_s = self._loop.now.time_s

    def _lift(self) -> None:
        """Raise the indenter to travelling height, and wait there."""
        options = self._options
        top = float(self._posture.heights_m[-1])
        fast = FAST * options.approach_m_per_s * self._loop.period_s
        pressed = self._loop.doing == "unload"
        while self._height_m < top:
            self._height_m = min(self._height_m + fast, top)
            sample = self._step()
            if pressed and self._regulator.normal_n < options.contact_n / 2:
                self.moments.end_s, pressed = sample.time_s + options.before_s, False
        if pressed:
            self.moments.end_s = self._loop.now.time_s
        self._loop.doing = "idle"
        for _ in range(self._loop.steps(options.idle_s)):
            self._step()
