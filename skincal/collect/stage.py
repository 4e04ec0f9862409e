"""Presses of a plan on a stage, which measures positions and forces directly, without a hand."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skincal.collect.collection import Collected, keep_session, plan_digest
from skincal.collect.journal import Journal, digest_of
from skincal.collect.mount import Mount
from skincal.collect.plan import Plan, PlannedPress
from skincal.collect.press import Moments
from skincal.collect.press_options import CollectOptions
from skincal.collect.record import missed_target
from skincal.dataset import HOLD, IDLE, LOAD, UNLOAD
from skincal.errors import InputError, Problem, WorkError, input_error
from skincal.hand import GuardOptions
from skincal.hand.stage import StageDescription, StageDriver, StageState
from skincal.hand.stage_guard import GuardedStage
from skincal.model.arrays import FloatArray

StageWatch = Callable[[int, int], None]

GAIN = 0.25
"""Part of the missing depth that is corrected per period; above 0.6, two periods of lag would make it oscillate."""

SOFTEST_N_PER_M = 2e3
"""Smallest stiffness assumed for a skin at first contact [N/m]."""

BLIND_M, BLIND_S = 0.5e-3, 0.05
"""Largest way into the skin without any growth of the force, for a skin as soft as can be and a slow load cell: the
way itself, and the time at the press's speed [m, s]."""

GAP_S = 1.0
"""Gap between the sessions before and after an interruption [s]."""


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
            problems.append(
                Problem(where, "a site within the travel of the stage", f"{point[:2].tolist()} m")
            )
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


def collect_stage(
    plan: Plan,
    make_driver: Callable[[], StageDriver],
    out: Path,
    *,
    key: Mapping[str, Any] | None = None,
    options: CollectOptions | None = None,
    guard: GuardOptions | None = None,
    source: str = "",
    force: bool = False,
    inputs: Sequence[Path] = (),
    restart: bool = False,
    watch: StageWatch = lambda _done, _total: None,
) -> Collected:
    """Make the presses of a plan with a stage and write the dataset; resume an interrupted session.

    Args:
        plan: from :func:`stage_plan`.
        make_driver: creates the driver.
        out: folder of the dataset.
        key: further values that must be equal to resume a session.
        options: options of the presses.
        guard: limits of the guard.
        source: for ``dataset.toml``.
        force: whether an existing dataset is replaced.
        inputs: files that were read, and are not to be replaced.
        restart: whether an interrupted session is thrown away.
        watch: is told how many presses are done, and of how many.

    Raises:
        InputError: ``out`` exists, or another session was interrupted.
        HandError: the stage failed; call again to resume.
    """
    options = options or CollectOptions()
    driver = make_driver()
    rig = driver.description
    _check_height(rig, options.clearance_m)
    same = {"plan": plan_digest(plan), "stage": rig.name,
            **(key or {}), "options": digest_of(repr(asdict(options)))}  # fmt: skip

    def make(journal: Journal) -> None:
        _Session(plan, journal, rig, options, watch).run(driver, guard)

    return keep_session(out, same, rig.meta, source, make, inputs=inputs, force=force, restart=restart)


def _check_height(rig: StageDescription, clearance_m: float) -> None:
    """Refuse a stage that cannot lift its tip off the skin, or not reach the skin."""
    low, high = float(rig.lower_m[2]), float(rig.upper_m[2])
    if not low < 0 < clearance_m <= high:
        expected = f"travel along z from below the skin (z = 0) to {clearance_m:g} m above it"
        raise input_error(f"stage {rig.name}", expected, f"{low:g} m to {high:g} m")


class _Session:
    """Executor of the missing presses of a session."""

    def __init__(
        self, plan: Plan, journal: Journal, rig: StageDescription, options: CollectOptions, watch: StageWatch
    ) -> None:
        self._plan, self._journal, self._options, self._watch = plan, journal, options, watch
        self._points, _ = Mount.of(rig.meta).place(plan.sites_m())
        self._cycles = plan.cycles()
        done = journal.presses()
        self._todo = [number for number in range(len(plan)) if number not in done]
        times = [a["frames.time_s"] for a in (*done.values(), *journal.rests())]
        self._last_s = max((float(t[-1]) for t in times if len(t)), default=-np.inf)

    def run(self, driver: StageDriver, guard: GuardOptions | None) -> None:
        if not self._todo:
            return
        with GuardedStage(driver, guard) as stage:
            self._stage, self._samples, self._shift_s = stage, list[tuple[StageState, int]](), 0.0
            self._see(IDLE)
            if np.isfinite(self._last_s):
                # Another connection, another clock: the session's own continues a moment later.
                self._shift_s = self._last_s + GAP_S - self._samples[0][0].time_s
            self._journal.connected(
                {"first": self._todo[0], "resumed": bool(np.isfinite(self._last_s)), "shift_s": self._shift_s}
            )
            self._tip = np.clip(self._now.position_m, stage.description.lower_m, stage.description.upper_m)
            top = self._options.clearance_m
            self._go([*self._tip[:2], max(float(self._tip[2]), top)])
            self._wait(self._options.rest_s)
            self._keep_rest()
            for done, number in enumerate(list(self._todo)):
                self._watch(len(self._plan) - len(self._todo) + done, len(self._plan))
                self._press(number, self._plan.presses[number])
            self._wait(self._options.rest_s)
            self._keep_rest()
        self._watch(len(self._plan), len(self._plan))

    def _see(self, phase: int) -> StageState:
        self._now = self._stage.observe()
        self._samples.append((self._now, phase))
        return self._now

    def _step(self, tip: FloatArray | list[float], phase: int) -> StageState:
        # A state that came early leaves less time for a step than a period.
        self._tip = self._stage.nearest(np.asarray(tip, dtype=np.float64))
        self._stage.act(self._tip)
        return self._see(phase)

    def _wait(self, seconds: float, phase: int = IDLE) -> None:
        for _ in range(max(1, round(seconds / self._stage.period_s))):
            self._step(self._tip, phase)

    def _go(self, target: FloatArray | list[float]) -> None:
        """Move straight to a point, no faster than allowed."""
        rig = self._stage.description
        step = 0.9 * min(self._options.travel_m_per_s, rig.max_speed_m_per_s) * self._stage.period_s
        end = np.clip(target, rig.lower_m, rig.upper_m)
        while (left := float(np.linalg.norm(end - self._tip))) > 0:
            self._step(self._tip + (end - self._tip) * min(1.0, step / left), IDLE)

    def _press(self, number: int, planned: PlannedPress) -> None:
        options, dt = self._options, self._stage.period_s
        point, top = self._points[number], self._options.clearance_m
        self._go([point[0], point[1], top])
        begin = len(self._samples)
        self._wait(max(options.still_s, 5 * dt))
        tare = float(np.mean([state.force_n for state, _ in self._samples[begin:]]))
        times, found = Moments(), float("nan")
        slow = min(options.approach_m_per_s, 0.9 * self._stage.description.max_speed_m_per_s) * dt
        lowest = max(-options.search_m, float(self._stage.description.lower_m[2]))
        felt = 0
        while felt < 2 and self._tip[2] - slow > lowest:
            state = self._step(self._tip - np.array([0.0, 0.0, slow]), LOAD)
            felt = felt + 1 if state.force_n - tare > options.contact_n else 0
        if felt >= 2:
            found = float(self._tip[2])
            times.start_s = self._time(self._now) - options.before_s
            self._regulate(
                planned.force_n, tare, found, planned, LOAD, options.reach_s + self._ramp_s(planned)
            )
            times.hold_s = self._time(self._now)
            self._regulate(planned.force_n, tare, found, planned, HOLD, planned.hold_s)
            times.release_s = self._time(self._now)
        up = planned.speed_m_per_s * dt
        while self._tip[2] < top:
            pressed = np.isfinite(times.release_s) and not np.isfinite(times.end_s)
            phase = UNLOAD if pressed else IDLE
            state = self._step(self._tip + np.array([0.0, 0.0, min(up, top - self._tip[2])]), phase)
            if pressed and state.force_n - tare < options.contact_n / 2:
                times.end_s = self._time(state)
        self._wait(options.idle_s)
        self._keep(number, planned, point, tare, times)

    def _ramp_s(self, planned: PlannedPress) -> float:
        """Return the time to enter a soft skin at the planned speed, plus half a second to come to rest."""
        return self._options.search_m / planned.speed_m_per_s + 0.5

    def _regulate(
        self, target_n: float, tare: float, found_m: float, planned: PlannedPress, phase: int, seconds: float
    ) -> None:
        """Move the tip until the force is right; during loading it stops there, during the hold it stays regulated."""
        dt, lowest = self._stage.period_s, self._stage.description.lower_m[2]
        near = max(0.5 * self._options.tolerance_n, 0.5 * self._options.tolerance_share * target_n)
        right, blind_m = 0, BLIND_M + BLIND_S * planned.speed_m_per_s
        most_n, there_m = -np.inf, found_m
        for _ in range(max(1, round(seconds / dt))):
            force, place_m = self._now.force_n - tare, float(self._now.position_m[2])
            if force > most_n + self._options.contact_n / 2:
                most_n, there_m = force, place_m
            if phase == LOAD and there_m - place_m > blind_m:
                raise WorkError(
                    f"load cell: expected a force that grows on a way of {1e3 * (there_m - place_m):.3g} mm into the "
                    f"skin; it stayed at {force:.3g} N. Is the load cell connected?"
                )
            # For a sphere on a foundation the force grows with the square of the depth: dF/dz = 2 F / z.
            depth = max(found_m - float(self._tip[2]), 1e-5)
            stiffness = max(2 * force / depth, SOFTEST_N_PER_M)
            step = np.clip(
                GAIN * (target_n - force) / stiffness, -planned.speed_m_per_s * dt, planned.speed_m_per_s * dt
            )
            self._step([self._tip[0], self._tip[1], max(float(self._tip[2] - step), lowest)], phase)
            right = right + 1 if abs(self._now.force_n - tare - target_n) < near else 0
            if phase == LOAD and right >= 5:
                return

    def _time(self, state: StageState) -> float:
        return state.time_s + self._shift_s

    def _frames(self) -> dict[str, NDArray[Any]]:
        """Return the samples since the last call, thinned to the rate of frames."""
        states, phases = zip(*self._samples, strict=True)
        self._samples.clear()
        times = np.array([self._time(state) for state in states], dtype=np.float64)
        every = max(1, round(1 / (self._options.frame_rate_hz * self._stage.period_s)))
        keep = np.arange(0, len(times), every)
        place = np.array([state.position_m for state in states], dtype=np.float64)[keep]
        return {
            "time_s": times[keep],
            "counts": np.array([state.taxels for state in states], dtype=np.float64)[keep],
            "force_n": np.array([state.force_n for state in states], dtype=np.float64)[keep],
            **{name: place[:, i] for i, name in enumerate(("x_m", "y_m", "z_m"))},
            "phase": np.array(phases)[keep],
        }

    def _keep_rest(self) -> None:
        frames = self._frames()
        nothing = np.full(len(frames["time_s"]), np.nan)
        frames |= {"press": np.full(len(nothing), -1), "cycle": nothing, "speed_m_per_s": nothing}
        frames["phase"] = np.full(len(nothing), IDLE)
        self._journal.keep_rest({f"frames.{name}": column for name, column in frames.items()})

    def _keep(
        self, number: int, planned: PlannedPress, point: FloatArray, tare: float, times: Moments
    ) -> None:
        held = [
            state
            for state, phase in self._samples
            if phase == HOLD and self._time(state) >= times.hold_s + self._options.settle_s
        ]
        status = "no_contact" if not np.isfinite(times.start_s) else "ok"
        if not held:
            held = [self._samples[-1][0]]
        force = float(np.mean([state.force_n for state in held])) - tare
        place: FloatArray = np.mean(np.array([state.position_m for state in held], dtype=np.float64), axis=0)
        missed = missed_target(planned, force, self._options)
        if missed and status == "ok":
            status = "missed_target"
        row: dict[str, Any] = {
            "press": number,
            "force_n": force,
            **dict(zip(("x_m", "y_m", "z_m"), (place[0], place[1], 0.0), strict=True)),
            "t_start_s": times.start_s,
            "t_hold_s": times.hold_s,
            "t_release_s": times.release_s,
            "t_end_s": times.end_s,
            **dict(zip(("target_x_m", "target_y_m", "target_z_m"), point, strict=True)),
            "target_force_n": planned.force_n,
            "speed_m_per_s": planned.speed_m_per_s,
            "cycle": self._cycles[number],
            "kind": planned.kind,
            "missed_target": int(missed),
            "status": status,
            "force_rest_n": tare,
        }
        counts: FloatArray = np.mean(np.array([state.taxels for state in held], dtype=np.float64), axis=0)
        frames = self._frames()
        frames["force_n"] = frames["force_n"] - tare
        frames["z_m"] = np.zeros_like(frames["z_m"])
        begun = frames["time_s"] >= times.start_s
        ended = frames["time_s"] > (times.end_s if np.isfinite(times.end_s) else np.inf)
        phase = np.where(begun & ~ended, frames["phase"], IDLE)
        touched = phase != IDLE
        frames |= {
            "phase": phase,
            "press": np.where(touched, number, -1),
            "cycle": np.where(touched, float(self._cycles[number]), np.nan),
            "speed_m_per_s": np.where(touched, planned.speed_m_per_s, np.nan),
        }
        self._journal.keep_press(
            number,
            {
                **{f"press.{name}": np.asarray(value) for name, value in row.items()},
                "press.counts": counts,
                **{f"frames.{name}": column for name, column in frames.items()},
            },
        )
