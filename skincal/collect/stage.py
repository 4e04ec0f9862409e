"""Presses of a plan on a stage, which measures positions and forces directly, without a hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skincal.collect.force_checks import BLIND_M, BLIND_S, ApproachCheck, ForceGrowth
from skincal.collect.journal import Arrays
from skincal.collect.plan import Plan, PlannedPress
from skincal.collect.posture import Mount
from skincal.collect.press import Moments
from skincal.collect.session import MakeDriver, Session, StageSample
from skincal.covariates import POSITION
from skincal.dataset import HOLD, IDLE, LOAD, PHASES, UNLOAD
from skincal.errors import InputError, Problem, input_error
from skincal.hand import GuardedStage, GuardOptions, StageDescription, StageDriver, StageState
from skincal.hand.loop import ControlLoop
from skincal.model.arrays import FloatArray

GAIN = 0.25
"""Part of the missing depth that is corrected per period; above 0.6, two periods of lag would make it oscillate."""

SOFTEST_N_PER_M = 2e3
"""Smallest stiffness assumed for a skin at first contact [N/m]."""

SENSOR, POSITIVE = "load cell", "a load cell reads a positive force when the indenter presses"
"""Name and sign of the force sensor, for errors."""


def stage_plan(plan: Plan, rig: StageDescription) -> Plan:
    """Return a plan that a stage can carry out: without hand poses, and with speeds within its limit.

    Raises:
        InputError: the surface is not a plane, a site is outside the travel, or a force or indenter is unavailable.
    """
    mount = Mount.of(rig.meta)
    problems: list[Problem] = []
    if not rig.meta.surface.is_plane:
        expected = "a plane: a stage presses along z, and the normals of a curved surface differ from that"
        problems.append(Problem(f"stage {rig.name}, [surface] kind", expected, rig.meta.surface.kind))
    points, _ = mount.place(plan.sites_m())
    for number, (press, point) in enumerate(zip(plan.presses, points, strict=True)):
        where = f"plan {plan.name}, press {number}"
        if not ((point[:2] >= rig.lower_m[:2]) & (point[:2] <= rig.upper_m[:2])).all():
            got = f"{point[:2].tolist()} m"
            problems.append(Problem(where, "a site within the travel of the stage", got))
        if press.force_n > 0.9 * rig.max_force_n:
            expected = f"a force of at most {0.9 * rig.max_force_n:g} N (the rig's max_force_n)"
            problems.append(Problem(where, expected, f"{press.force_n:g} N"))
        if press.indenter_radius_m is not None:
            problems.append(Problem(where, "the stage's own indenter", f"{press.indenter_radius_m:g} m"))
    if problems:
        raise InputError(problems)
    fastest = 0.5 * rig.max_speed_m_per_s
    presses = tuple(
        replace(press, pose="A", speed_m_per_s=min(press.speed_m_per_s, fastest)) for press in plan.presses
    )
    return replace(plan, presses=presses, poses={})


def check_height(rig: StageDescription, clearance_m: float) -> None:
    """Refuse a stage that cannot lift its tip off the skin, or not reach the skin."""
    low, high = float(rig.lower_m[2]), float(rig.upper_m[2])
    if not low < 0 < clearance_m <= high:
        expected = f"travel along z from below the skin (z = 0) to {clearance_m:g} m above it"
        raise input_error(f"stage {rig.name}", expected, f"{low:g} m to {high:g} m")


def press_on_stage(session: Session, make_driver: MakeDriver, guard: GuardOptions | None) -> None:
    """Make the missing presses of a session; errors are those of :func:`skincal.collect.collect`."""
    if not session.todo:
        return
    driver = make_driver(session.need())
    assert isinstance(driver, StageDriver)
    with GuardedStage(driver, guard) as stage:
        StagePresses(session, stage).run()


class StagePresses(ControlLoop[GuardedStage, StageSample]):
    """Executor of the missing presses of a session with a connected stage; commands are positions of the tip."""

    def __init__(self, session: Session, stage: GuardedStage) -> None:
        super().__init__(stage, session.report)
        self._session, self._options, self._phase, self._tare_n = session, session.options, IDLE, 0.0
        rig = stage.description
        self._points, _ = Mount.of(rig.meta).place(session.plan.sites_m())
        first = stage.observe()
        self._shift_s = session.connect(first.time_s)
        self.command = np.clip(first.position_m, rig.lower_m, rig.upper_m)

    def run(self) -> None:
        """Make the presses, and record the skin at rest before and after them."""
        self._go([*self.command[:2], max(float(self.command[2]), self._options.clearance_m)])
        self._rest()
        for number in list(self._session.todo):
            self._press(number, self._session.plan.presses[number])
        self._rest()

    def _rest(self) -> None:
        self._wait(self._options.rest_s)
        self._session.keep_rest(self._frames())

    def _sample(self, state: StageState) -> StageSample:
        return StageSample(state.time_s + self._shift_s, state.force_n - self._tare_n, state, self._phase)

    def _move(self, tip: FloatArray | list[float], phase: int = IDLE) -> StageSample:
        self._phase, self.doing = phase, PHASES[phase]
        return self.step(np.asarray(tip, dtype=np.float64))

    def _wait(self, seconds: float) -> None:
        for _ in range(self.steps(seconds)):
            self._move(self.command)

    def _go(self, target: FloatArray | list[float]) -> None:
        """Move straight to a point, no faster than allowed."""
        rig = self.rig.description
        step = 0.9 * min(self._options.travel_m_per_s, rig.max_speed_m_per_s) * self.period_s
        end = np.clip(target, rig.lower_m, rig.upper_m)
        while (left := float(np.linalg.norm(end - self.command))) > 0:
            self._move(self.command + (end - self.command) * min(1.0, step / left))

    def _press(self, number: int, planned: PlannedPress) -> None:
        options, rig, dt = self._options, self.rig.description, self.period_s
        point, top = self._points[number], self._options.clearance_m
        self._tare_n = 0.0
        self._go([point[0], point[1], top])
        begin = len(self.samples)
        self._wait(max(options.still_s, 5 * dt))
        self._tare_n = float(np.mean([sample.state.force_n for sample in self.samples[begin:]]))
        times = Moments()
        slow = min(options.approach_m_per_s, 0.9 * rig.max_speed_m_per_s) * dt
        lowest = max(-options.search_m, float(rig.lower_m[2]))
        touching, blind_m = 0, BLIND_M + BLIND_S * slow / dt
        free = [sample.state.taxels for sample in self.samples]
        check = ApproachCheck(SENSOR, rig.meta, free, options.contact_n, blind_m, POSITIVE)
        while touching < 2 and self.command[2] - slow > lowest:
            sample = self._move(self.command - np.array([0.0, 0.0, slow]), LOAD)
            check.check(sample.force_n, float(sample.state.position_m[2]), sample.state.taxels)
            touching = touching + 1 if sample.force_n > options.contact_n else 0
        if touching >= 2:
            contact_m = float(self.command[2])
            times.start_s = self.now.time_s - options.before_s
            # The time to enter a soft skin at the planned speed, and half a second to come to rest.
            ramp_s = options.search_m / planned.speed_m_per_s + 0.5
            self._regulate(contact_m, planned, LOAD, options.reach_s + ramp_s)
            times.hold_s = self.now.time_s
            self._regulate(contact_m, planned, HOLD, planned.hold_s)
            times.release_s = self.now.time_s
        up = planned.speed_m_per_s * dt
        while self.command[2] < top:
            pressed = np.isfinite(times.release_s) and not np.isfinite(times.end_s)
            phase = UNLOAD if pressed else IDLE
            sample = self._move(self.command + np.array([0.0, 0.0, min(up, top - self.command[2])]), phase)
            if pressed and sample.force_n < options.contact_n / 2:
                times.end_s = sample.time_s
        self._wait(options.idle_s)
        self._keep(number, times)

    def _regulate(self, contact_m: float, planned: PlannedPress, phase: int, seconds: float) -> None:
        """Move the tip until the force is right; during loading it stops there, during the hold it stays regulated."""
        dt, lowest, target_n = self.period_s, self.rig.description.lower_m[2], planned.force_n
        near = max(0.5 * self._options.tolerance_n, 0.5 * self._options.tolerance_share * target_n)
        right, blind_m = 0, BLIND_M + BLIND_S * planned.speed_m_per_s
        growth = ForceGrowth(SENSOR, self._options.contact_n, blind_m)
        for _ in range(self.steps(seconds)):
            force = self.now.force_n
            if phase == LOAD:
                growth.check(force, float(self.now.state.position_m[2]))
            # For a sphere on a foundation the force grows with the square of the depth: dF/dz = 2 F / z.
            depth = max(contact_m - float(self.command[2]), 1e-5)
            stiffness = max(2 * force / depth, SOFTEST_N_PER_M)
            largest = planned.speed_m_per_s * dt
            step = np.clip(GAIN * (target_n - force) / stiffness, -largest, largest)
            self._move([*self.command[:2], max(float(self.command[2] - step), lowest)], phase)
            right = right + 1 if abs(self.now.force_n - target_n) < near else 0
            if phase == LOAD and right >= 5:
                return

    def _frames(self) -> Arrays:
        """Return the samples since the last call, thinned to the rate of frames; forces as the load cell reads them."""
        every = max(1, round(1 / (self._options.frame_rate_hz * self.period_s)))
        kept = self.take()[::every]
        states = [sample.state for sample in kept]
        place = np.array([state.position_m for state in states], dtype=np.float64)
        return {
            "time_s": np.array([sample.time_s for sample in kept], dtype=np.float64),
            "counts": np.array([state.taxels for state in states], dtype=np.float64),
            "force_n": np.array([state.force_n for state in states], dtype=np.float64),
            **{name: place[:, i] for i, name in enumerate(POSITION)},
            "phase": np.array([sample.phase for sample in kept]),
        }

    def _keep(self, number: int, times: Moments) -> None:
        begin_s = times.hold_s + self._options.settle_s
        held = [one.state for one in self.samples if one.phase == HOLD and one.time_s >= begin_s]
        held = held or [self.now.state]
        force = float(np.mean([state.force_n for state in held])) - self._tare_n
        place: FloatArray = np.mean(np.array([state.position_m for state in held], dtype=np.float64), axis=0)
        means = {"force_n": force, "x_m": float(place[0]), "y_m": float(place[1]), "z_m": 0.0}
        row = self._session.press_row(number, self._points[number], times, means)
        del row["pose"]  # of a hand
        row["status"] = "missed_target" if row["missed_target"] else "ok"
        if not np.isfinite(times.start_s):
            row["status"] = "no_contact"
        row["force_rest_n"] = self._tare_n
        row["counts"] = np.mean(np.array([state.taxels for state in held], dtype=np.float64), axis=0)
        frames = self._frames()
        frames["force_n"] = frames["force_n"] - self._tare_n
        frames["z_m"] = np.zeros_like(frames["z_m"])
        begun = frames["time_s"] >= times.start_s
        ended = frames["time_s"] > (times.end_s if np.isfinite(times.end_s) else np.inf)
        phase = np.where(begun & ~ended, frames["phase"], IDLE)
        self._session.keep(number, row, frames | self._session.phase_columns(phase, number))
