"""A policy's run on a hand: take the object, act at 10 Hz, release it; stop on any fault."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skincal.deploy.handover import DeployOptions, Handover, Motion, PinchForces, Watch
from skincal.deploy.record import Record
from skincal.envs.pinch import Pinch
from skincal.envs.postures import Postures
from skincal.envs.trajectories import POLICY_HZ
from skincal.errors import InputError, Problem, WorkError, input_error
from skincal.hand.driver import HandDriver
from skincal.hand.guard import GuardedHand
from skincal.hand.guard_options import GuardOptions
from skincal.model.arrays import FloatArray
from skincal.robot import JointLimits
from skincal.robot.description import values_of
from skincal.train.policy_file import Policy


@dataclass(frozen=True, eq=False)
class Deployed:
    """Result of a run.

    Attributes:
        record: states of the hand, and positions of the object.
        targets: (T, d) target at each step of the policy [m].
        steps: number of steps that have passed.
        missed: number of these steps at which the policy did not act, because no state came in time.
        lost_s: time at which the object was lost [s]; None: it was held to the end.
        error_m: (steps,) distance of the object from the target [m]; NaN if the hand does not know it.
        period_s: times between steps of the policy, on the hand's clock [s].
        own_period_s: the same on this computer's clock [s].
        inference_s: computing time of the policy at each step [s].
    """

    record: Record
    targets: FloatArray
    steps: int
    missed: int
    lost_s: float | None
    error_m: FloatArray
    period_s: FloatArray
    own_period_s: FloatArray
    inference_s: FloatArray

    @property
    def jitter_s(self) -> float:
        """Standard deviation of the policy's period, on the hand's clock [s]."""
        return float(np.std(self.period_s[1:])) if len(self.period_s) > 1 else 0.0


def deploy(
    policy: Policy,
    driver: HandDriver,
    pinch: Pinch,
    targets: FloatArray,
    *,
    object_width_m: float,
    speed_rad_per_s: float,
    options: DeployOptions | None = None,
    guard: GuardOptions | None = None,
    watch: Watch | None = None,
    cut_short: Callable[[Callable[[], Deployed]], None] | None = None,
    clock: Callable[[], float] = time.monotonic,
) -> Deployed:
    """Let a policy move an object between the fingers of a hand.

    Args:
        policy: the policy, evaluated without exploration noise.
        driver: the hand; not connected.
        pinch: the hand's grasp of small objects.
        targets: (T, d) targets at 10 Hz: patch coordinates of the marble, or the bolt's displacement along its normal
            [m].
        object_width_m: width of the object between the fingertips [m].
        speed_rad_per_s: joint velocity that an action of 1 commands, as in training [rad/s].
        options: times, speeds, forces.
        guard: limits of the guard.
        watch: callback for every state.
        cut_short: callback if an error or an interrupt ends the policy's acting; its argument is a function that
            returns the run so far.
        clock: clock of this computer [s].

    Returns:
        Result of the run, also if the object was lost.

    Raises:
        InputError: the driver describes another hand than ``pinch``; the policy is for another hand or task, or needs
            taxels that the hand does not have.
        HandError: the hand had a fault, and has been stopped.
        WorkError: there was no object between the fingers, the policy gave no finite action, or the loop fell behind.
    """
    options = options or DeployOptions()
    _check_same_hand(driver, pinch)
    joints, taxels = pinch.joints, pinch.description.meta.sensor.taxels
    sizes = {"image": taxels, "target": targets.shape[1], "movement": targets.shape[1]}
    sizes |= dict.fromkeys(("desired", "measured", "error"), joints)
    observation = PolicyObservation(policy.description.observation, sizes, policy.file)
    if policy.description.actions != joints:
        expected = f"a policy that moves {joints} joints, as the hand has"
        raise input_error(policy.file, expected, f"one for {policy.description.actions}")
    postures, forces = Postures.of(pinch), PinchForces(pinch)
    loop: _PolicyLoop | None = None
    try:
        with GuardedHand(driver, guard, clock=clock, contact_force=forces.largest_n) as hand:
            motion = Motion(hand, watch)
            state = motion.look()
            if observation.has_image and not np.isfinite(state.taxels).any():
                raise input_error(f"driver {hand.name}", f"{taxels} taxels, for a tactile policy", "none")
            handover = Handover(motion, pinch.description, postures, forces, object_width_m, options)
            command = handover.take()
            step_rad, limits = speed_rad_per_s / POLICY_HZ, pinch.description.limits
            loop = _PolicyLoop(policy, observation, motion, forces, targets, limits, step_rad, options)
            loop.run(command)
            if loop.lost_s is None:
                handover.let_go()
    except BaseException:
        if loop is not None and loop.acting and cut_short is not None:
            cut_short(loop.result)
        raise
    return loop.result()


def _check_same_hand(driver: HandDriver, pinch: Pinch) -> None:
    """Refuse a driver of another hand: forces, limits and the order of the joints come from both descriptions."""
    its = driver.description
    # In a pinch, the second finger ends in its bare tip.
    finger = replace(its.indenter_finger, tip_link=pinch.thumb.tip_link)
    its, ours = values_of(replace(its, indenter_finger=finger)), values_of(pinch.description)
    if different := [name for name in {**ours, **its} if ours.get(name) != its.get(name)]:
        expected = f'the hand "{pinch.description.name}" of hand.toml and URDF, as the driver describes it'
        fix = "Give the folder with the driver's own hand.toml and a pinch.toml: --hand FOLDER."
        raise input_error(f"driver {driver.name}", expected, f"other values of {', '.join(different)}", fix)


@dataclass(eq=False)
class _PolicyLoop:
    """The policy's 10 Hz loop within the hand's faster control loop.

    Steps begin on a regular grid of the hand's clock. A step without a state in time is missed, and the hand continues
    to its last command. Between steps, the commanded angles follow the policy's through a first-order low-pass.
    """

    policy: Policy
    observation: PolicyObservation
    motion: Motion
    forces: PinchForces
    targets: FloatArray
    limits: JointLimits
    step_rad: float
    options: DeployOptions
    lost_s: float | None = None
    first: int = 0
    missed: int = 0
    errors: list[float] = field(default_factory=list[float])
    begun_s: list[float] = field(default_factory=list[float])
    own_s: list[float] = field(default_factory=list[float])
    inference_s: list[float] = field(default_factory=list[float])

    def run(self, command_rad: FloatArray) -> None:
        """Act until the end of the targets, or until the object is lost."""
        motion, limits = self.motion, self.limits
        motion.doing = "acting"
        desired, sent = command_rad.copy(), command_rad.copy()
        start_s, self.first = motion.now.time_s, len(motion.samples) - 1
        empty_s, sent_s, k = 0.0, start_s - motion.period_s, 0
        while k < len(self.targets) - 1:
            wanted = desired + self.step_rad * self._action(k, desired)
            desired = np.clip(wanted, limits.lower_rad, limits.upper_rad)
            end_s = start_s + (k + 1) / POLICY_HZ
            while motion.now.time_s < end_s - 0.5 * motion.period_s:
                # Use the measured time step: with a slow link it exceeds the period.
                passed_s, sent_s = motion.now.time_s - sent_s, motion.now.time_s
                fraction = -math.expm1(-2 * math.pi * self.options.low_pass_hz * passed_s)
                sent = sent + fraction * (desired - sent)
                motion.step(sent)
                held = max(self.forces.normal_n(motion.now)) > self.options.contact_n / 2
                empty_s = 0.0 if held else empty_s + motion.now.time_s - sent_s
            late_s = motion.now.time_s - end_s
            if late_s > self.options.late_s:
                raise WorkError(
                    f"policy loop: expected step {k + 1} at {end_s:.3f} s of the hand's clock; got to it at "
                    f"{motion.now.time_s:.3f} s. The hand was stopped. Is the link to the hand too slow?"
                )
            missed = min(int(max(late_s, 0.0) * POLICY_HZ), len(self.targets) - 2 - k)
            self.errors += [math.nan] * missed
            self.missed += missed
            k += 1 + missed
            self.errors.append(self._error(k))
            if empty_s >= self.options.lost_s:
                self.lost_s = motion.now.time_s - start_s - empty_s
                break

    @property
    def acting(self) -> bool:
        """True if the policy has acted."""
        return "acting" in self.motion.phases

    def result(self) -> Deployed:
        """Return the result of the run so far."""
        return Deployed(
            Record.of(self.motion, self.first, self.forces), self.targets, len(self.errors),
            self.missed, self.lost_s, np.array(self.errors), np.diff(self.begun_s), np.diff(self.own_s),
            np.array(self.inference_s),
        )  # fmt: skip

    def _action(self, k: int, desired_rad: FloatArray) -> FloatArray:
        """Return the policy's action (n,) at step k, within ±1."""
        state, target = self.motion.now, self.targets[k]
        self.begun_s.append(state.time_s)
        self.own_s.append(time.monotonic())
        values = self.observation.next(
            {
                "image": state.taxels,
                "desired": desired_rad,
                "measured": state.q_rad,
                "error": desired_rad - state.q_rad,
                "target": target,
                "movement": target - self.targets[max(k - 1, 0)],
            }
        )
        action = np.asarray(self.policy(values), dtype=np.float64)
        self.inference_s.append(time.monotonic() - self.own_s[-1])
        if not np.isfinite(action).all():
            raise WorkError(f"{self.policy.file}: expected finite actions; got NaN at step {k}")
        return np.clip(action, -1.0, 1.0)

    def _error(self, k: int) -> float:
        """Return the distance of a marble from its target at step k [m]; NaN for a bolt or an unknown position."""
        target, place = self.targets[k], self.motion.places_m[-1]
        return float(np.linalg.norm(place - target)) if len(target) == 2 else float("nan")


class PolicyObservation:
    """Observation of a policy: present and past quantities, concatenated in the order of its description.

    Args:
        parts: parts of the observation from the description: ``name``, ``size``, ``steps_ago``.
        sizes: sizes of the quantities that the hand and the task provide, by name; others are refused.
        file: file of the policy, for errors.

    Raises:
        InputError: a part is unknown or has another size: the policy is for another hand or task.
    """

    def __init__(self, parts: Sequence[Mapping[str, Any]], sizes: Mapping[str, int], file: str) -> None:
        self._order = [(str(part["name"]), int(part.get("steps_ago", 0))) for part in parts]
        problems: list[Problem] = []
        for name, size in ((part["name"], part["size"]) for part in parts):
            if name not in sizes:
                problems.append(Problem(file, f"a policy that sees {', '.join(sizes)}", f'"{name}"'))
            elif int(size) != sizes[name]:
                expected = f"{sizes[name]} values of {name}, as this hand and task have"
                problems.append(Problem(file, expected, f"{size}; the policy is for another hand or task"))
        if problems:
            raise InputError(list(dict.fromkeys(problems)))
        self._past: deque[dict[str, NDArray[np.float64]]] = deque(maxlen=1 + max(a for _, a in self._order))

    @property
    def has_image(self) -> bool:
        """True if the policy observes the tactile image."""
        return any(name == "image" for name, _ in self._order)

    def next(self, values: Mapping[str, ArrayLike]) -> NDArray[np.float32]:
        """Return the next observation. At the first step, the present values also fill the past.

        Args:
            values: present quantities by name; NaN is replaced by 0.
        """
        now = {name: np.nan_to_num(np.asarray(value, dtype=np.float64)) for name, value in values.items()}
        self._past.append(now)
        while len(self._past) < (self._past.maxlen or 1):
            self._past.appendleft(now)
        return np.concatenate([self._past[-1 - ago][name] for name, ago in self._order]).astype(np.float32)
