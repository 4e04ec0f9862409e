"""Presses of a session, their times, and the commanded force at every sample.

Three protocols. ``full``: 90 presses in an order of chance, an anchor every ten, sites that are come back to, exact
repeats, two speeds, two holds, two hand poses, two indenters, some with a tangential force. ``raster``: the same kinds
of presses, but site after site in rows, without anchors, so that time and place are one. ``static``: 60 presses at
places of chance, of which only the hold is told.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.blind.truth.rig import NOMINAL_Y_M, RATE_HZ, SPHERES_M, Floats, Ints

FAST_M_PER_S, SLOW_M_PER_S = 0.002, 0.00025
SHORT_S, LONG_S = 1.0, 6.0
FORCES_N = (0.3, 6.0)
ANCHOR_N, ANCHOR_EVERY = 2.5, 10
PRESSES, STATIC_PRESSES, SITES = 90, 60, 25
LEAD_S = 3.0
IDLE, LOAD, HOLD, UNLOAD = range(4)
PHASES = np.array(["idle", "load", "hold", "unload"], dtype=object)

Depth = Callable[[float, Floats], Floats]
"""How far a sphere of a radius [m] sinks in under forces [N], in metres."""


@dataclass(frozen=True)
class Press:
    """Commanded values of a press."""

    site: int
    arc_m: float
    along_m: float
    force_n: float
    sphere_m: float
    speed_m_per_s: float
    hold_s: float
    pose: int
    shear_share: tuple[float, float]


@dataclass(frozen=True, eq=False)
class Plan:
    """A session's presses and the clock of each.

    Attributes:
        presses: in their order.
        cycle: (K,) earlier touches of the same site.
        times_s: (K, 4) start, hold, release and end [s].
    """

    presses: Sequence[Press]
    cycle: Ints
    times_s: Floats

    def column(self, name: str) -> Floats:
        """A number of every press (K,)."""
        return np.array([getattr(press, name) for press in self.presses], dtype=np.float64)

    @property
    def shear_share(self) -> Floats:
        """Tangential over normal force, round and along the finger (K, 2)."""
        return np.array([press.shear_share for press in self.presses])


@dataclass(frozen=True, eq=False)
class Timeline:
    """The session at 25 Hz.

    Attributes:
        time_s: (N,) [s].
        press: (N,) row of the press; -1 where nothing touches.
        near: (N,) row of the press that is on or comes next (after the last: the last).
        phase: (N,) one of IDLE, LOAD, HOLD, UNLOAD.
        part: (N,) commanded force over that of the hold.
    """

    time_s: Floats
    press: Ints
    near: Ints
    phase: Ints
    part: Floats


def make_plan(rng: np.random.Generator, protocol: str, depth: Depth) -> Plan:
    """A session's plan; ``protocol`` is ``full``, ``raster`` or ``static``."""
    presses = {"full": _full, "raster": _raster, "static": _static}[protocol](rng)
    return Plan(presses, _cycles(presses), _clock(rng, presses, depth))


def timeline(plan: Plan, depth: Depth) -> Timeline:
    """Return the commanded values at every sample."""
    time = np.arange(int((plan.times_s[-1, 3] + LEAD_S) * RATE_HZ) + 1) / RATE_HZ
    start, hold, release, end = plan.times_s.T
    near = np.minimum(np.searchsorted(end, time, side="right"), len(plan.presses) - 1)
    touching = (time >= start[near]) & (time <= end[near])
    phase = np.full(len(time), IDLE)
    phase[touching] = LOAD
    phase[touching & (time >= hold[near])] = HOLD
    phase[touching & (time >= release[near])] = UNLOAD
    part = np.zeros(len(time))
    for row, press in enumerate(plan.presses):
        here = touching & (near == row)
        part[here] = _profile(time[here], plan.times_s[row], press, depth)
    return Timeline(time, np.where(touching, near, -1), near, phase, part)


def _profile(time_s: Floats, clock_s: Floats, press: Press, depth: Depth) -> Floats:
    """Force over that of the hold: the sphere sinks in and comes out at constant speed."""
    start, hold, release, end = clock_s
    way = np.clip(np.minimum((time_s - start) / (hold - start), (end - time_s) / (end - release)), 0.0, 1.0)
    force = np.linspace(0.0, press.force_n, 60)
    sunk = depth(press.sphere_m, force)
    return np.interp(way * sunk[-1], sunk, force) / press.force_n


def _full(rng: np.random.Generator) -> list[Press]:
    sites = _scattered(rng, SITES)
    count = PRESSES - PRESSES // ANCHOR_EVERY
    fresh = [_press(rng, number % SITES, *sites[number % SITES]) for number in range(count - 24)]
    order = [fresh[k] for k in rng.permutation(len(fresh))]
    for press in (order[k] for k in rng.choice(len(order), 24)):
        first = order.index(press)
        # After the first time, and more often late in the session.
        at = first + 1 + int((len(order) - first) * np.sqrt(rng.uniform()))
        order.insert(at, press)
    anchor = Press(
        SITES, 2e-3, NOMINAL_Y_M - 2e-3, ANCHOR_N, SPHERES_M[0], FAST_M_PER_S, SHORT_S, 0, (0.0, 0.0)
    )
    for at in range(0, PRESSES, ANCHOR_EVERY):
        order.insert(at, anchor)
    return order


def _raster(rng: np.random.Generator) -> list[Press]:
    """Rows of sites, each pressed once or a few times in a row."""
    across, along = np.linspace(-6.5e-3, 6.5e-3, 6), np.linspace(-7e-3, 7e-3, 7)
    sites = [(float(s), NOMINAL_Y_M + float(t)) for t in along for s in across]
    touches = 2 + (np.arange(len(sites)) < PRESSES - 2 * len(sites)).astype(int)
    return [_press(rng, n, *site) for n, site in enumerate(sites) for _ in range(touches[n])]


def _static(rng: np.random.Generator) -> list[Press]:
    steps = np.arange(-7, 8) * 1e-3
    chosen = rng.choice(len(steps) ** 2, STATIC_PRESSES, replace=False)
    presses = [
        _press(rng, n, float(steps[k % 15]), NOMINAL_Y_M + float(steps[k // 15]))
        for n, k in enumerate(chosen)
    ]
    plain = {"sphere_m": SPHERES_M[0], "hold_s": SHORT_S, "pose": 0, "speed_m_per_s": FAST_M_PER_S}
    return [replace(p, force_n=float(rng.uniform(1, 4)), **plain) for p in presses]


def _scattered(rng: np.random.Generator, count: int) -> list[tuple[float, float]]:
    """Sites over the patch, no two closer than 1.5 mm."""
    found: list[tuple[float, float]] = []
    while len(found) < count:
        s, t = rng.uniform(-7.2e-3, 7.2e-3), NOMINAL_Y_M + rng.uniform(-7.2e-3, 7.2e-3)
        if all(np.hypot(s - a, t - b) > 1.5e-3 for a, b in found):
            found.append((float(s), float(t)))
    return found


def _press(rng: np.random.Generator, site: int, arc_m: float, along_m: float) -> Press:
    force = float(np.clip(2.3 * np.exp(0.65 * rng.standard_normal()), *FORCES_N))
    sphere = SPHERES_M[int(rng.uniform() < 0.2)]
    speed = SLOW_M_PER_S if rng.uniform() < 0.42 else FAST_M_PER_S
    hold = LONG_S if rng.uniform() < 0.28 else SHORT_S
    share, way = (
        rng.uniform(0.1, 0.4) if rng.uniform() < 0.5 else rng.uniform(0, 0.04),
        rng.uniform(0, 2 * np.pi),
    )
    shear = (float(share * np.cos(way)), float(share * np.sin(way)))
    return Press(site, arc_m, along_m, force, sphere, speed, hold, int(rng.uniform() < 0.5), shear)


def _cycles(presses: Sequence[Press]) -> Ints:
    touched: dict[int, int] = {}
    cycle = np.zeros(len(presses), dtype=np.int64)
    for row, press in enumerate(presses):
        cycle[row] = touched.get(press.site, 0)
        touched[press.site] = int(cycle[row]) + 1
    return cycle


def _clock(rng: np.random.Generator, presses: Sequence[Press], depth: Depth) -> Floats:
    clock, now = np.zeros((len(presses), 4)), LEAD_S
    for row, press in enumerate(presses):
        loading = float(depth(press.sphere_m, np.array([press.force_n]))[0]) / press.speed_m_per_s
        loading = max(loading, 0.1)
        clock[row] = now + np.cumsum([0.0, loading, press.hold_s, loading])
        now = float(np.round(clock[row, 3] + rng.uniform(0.8, 2.0), 2))
    return np.round(clock, 2)
