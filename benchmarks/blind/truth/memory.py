"""Hidden effects of memory and time: hysteresis, creep, rate, latency, first cycle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from benchmarks.blind.truth.effect import Effect, Scene, Stage, lagged
from benchmarks.blind.truth.protocol import LOAD
from benchmarks.blind.truth.rig import Floats, Ints

_SUBSTEPS = 6


@dataclass(frozen=True)
class Hysteresis(Effect):
    """Bouc-Wen: ``y = x (1 - h z)``, ``dz = dx / D (1 - |z|^n (b sgn(z dx) + 1 - b))``.

    At rest the skin recovers: each press begins on the loading branch, ``z = 1``.
    """

    width_counts: float = 6.0
    power: float = 1.5
    share: float = 0.7

    name = "hysteresis"
    stage = Stage.MEMORY
    typical = 0.05
    largest = 0.6

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Effect:
        """See :meth:`Effect.draw`."""
        return cls(cls.typical, rng.uniform(4, 12), rng.uniform(1, 2), rng.uniform(0.5, 1.0))

    def signal(self, x: Floats, scene: Scene) -> Floats:
        """See :meth:`Effect.signal`."""
        touching = scene.touching
        first = np.array([rows[0] for rows in scene.by_press])
        length = np.array([len(rows) for rows in scene.by_press])
        rise = np.diff(x, axis=0, prepend=x[:1])
        z, state = np.ones_like(x), np.ones((len(first), x.shape[1]))
        # All presses side by side, each from its own beginning.
        for step in range(1, int(length.max())):
            live = np.flatnonzero(length > step)
            moving = live[np.abs(rise[first[live] + step]).max(axis=1) > 0]
            state[moving] = self._step(state[moving], rise[first[moving] + step])
            z[first[live] + step] = state[live]
        return np.where(touching[:, None], x * (1 - self.strength * z), x)

    def _step(self, z: Floats, rise: Floats) -> Floats:
        part = rise / self.width_counts / _SUBSTEPS
        for _ in range(_SUBSTEPS):
            pull = self.share * np.sign(z * part) + 1 - self.share
            z = np.clip(z + part * (1 - np.abs(z) ** self.power * pull), -1.0, 1.0)
        return z


@dataclass(frozen=True)
class Creep(Effect):
    """Two Prony terms of unlike weight, or a power law of time as a row of them: ``y = x + a sum w_k lag_k(x)``."""

    times_s: tuple[float, ...] = (0.4, 6.0)
    weights: tuple[float, ...] = (0.5, 0.5)

    name = "creep"
    stage = Stage.MEMORY
    typical = 0.08

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Effect:
        """See :meth:`Effect.draw`."""
        sign = 1.0 if rng.uniform() < 0.8 else -1.0
        if rng.uniform() < 0.6:
            first = rng.uniform(0.3, 0.7)
            times = (float(rng.uniform(0.2, 0.6)), float(rng.uniform(3, 10)))
            return cls(cls.typical, times, (sign * float(first), sign * float(1 - first)))
        times = 10.0 ** np.linspace(-1, 1.5, 7)
        weights = times ** rng.uniform(0.0, 0.3)
        return cls(cls.typical, tuple(times.tolist()), tuple((sign * weights / weights.sum()).tolist()))

    def signal(self, x: Floats, scene: Scene) -> Floats:
        """See :meth:`Effect.signal`."""
        del scene
        late = sum(w * lagged(x, t) for t, w in zip(self.times_s, self.weights, strict=True))
        return np.maximum(x + self.strength * late, 0.0)


@dataclass(frozen=True)
class Rate(Effect):
    """Eyring's: ``y = x (1 + a phi arsinh(v / v1))``; phi is one in loading and falls as ``1 / (1 + age / T)``."""

    fade_s: float = 3.0
    slow_m_per_s: float = 0.2e-3

    name = "rate"
    stage = Stage.MEMORY
    typical = 0.05
    largest = 0.5

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Effect:
        """See :meth:`Effect.draw`."""
        fade = (0.5, 5.0, 100.0)[rng.integers(3)]
        return cls(cls.typical, fade, float(rng.uniform(0.1e-3, 0.4e-3)))

    def signal(self, x: Floats, scene: Scene) -> Floats:
        """See :meth:`Effect.signal`."""
        speed = scene.of_press(scene.plan.column("speed_m_per_s"))
        age = np.maximum(scene.line.time_s - scene.of_press(scene.plan.times_s[:, 1]), 0.0)
        age = np.where(scene.line.phase == LOAD, 0.0, age)
        level = np.arcsinh(speed / self.slow_m_per_s) / (1 + age / self.fade_s)
        return x * (1 + self.strength * level)[:, None]


@dataclass(frozen=True)
class Latency(Effect):
    """A filter of second order between taxel and reading: two lags of half the delay each. Strength in seconds."""

    name = "latency"
    stage = Stage.CONVERTER
    typical = 0.04

    def signal(self, x: Floats, scene: Scene) -> Floats:
        """See :meth:`Effect.signal`."""
        del scene
        return lagged(lagged(x, self.strength / 2), self.strength / 2)


@dataclass(frozen=True)
class FirstCycle(Effect):
    """A site is worked in by the impulse D of its presses, force times time.

    ``y = x (1 + a / (1 + ln(1 + D / D0)))``.
    """

    impulse_n_s: float = 1.0

    name = "first_cycle"
    typical = 0.1
    largest = 0.8

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Effect:
        """See :meth:`Effect.draw`."""
        sign = 1.0 if rng.uniform() < 0.8 else -1.0
        return cls(cls.typical * sign, float(rng.uniform(0.3, 3.0)))

    def signal(self, x: Floats, scene: Scene) -> Floats:
        """See :meth:`Effect.signal`."""
        plan = scene.plan
        start, hold, release, end = plan.times_s.T
        # Ramps count half.
        lasts = (hold - start) / 2 + release - hold + (end - release) / 2
        met = _impulse_before(plan.column("site").astype(np.int64), plan.column("force_n") * lasts)
        return x * scene.of_press(1 + self.strength / (1 + np.log1p(met / self.impulse_n_s)))[:, None]


def _impulse_before(site: Ints, impulse_n_s: Floats) -> Floats:
    """The sum over earlier presses of the same site (K,) [N s]."""
    met = dict[int, float]()
    before = np.zeros(len(site))
    for row, (place, impulse) in enumerate(zip(site.tolist(), impulse_n_s.tolist(), strict=True)):
        before[row] = met.get(place, 0.0)
        met[place] = before[row] + impulse
    return before
