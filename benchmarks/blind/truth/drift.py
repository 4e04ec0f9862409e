"""Hidden effects of the session's time and temperature: drift of the level at rest, drift of the gain."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from benchmarks.blind.truth.effect import Effect, Scene, Stage, lagged
from benchmarks.blind.truth.rig import TAXELS, Floats

_CELSIUS_K = 273.15


def _warmth(scene: Scene, lag_s: float) -> Floats:
    """Warming since the session began, as the skin feels it (N,) [K]."""
    return lagged(scene.temperature_c - scene.temperature_c[0], lag_s)


@dataclass(frozen=True)
class BaselineDrift(Effect):
    """Each taxel creeps up with the logarithm of time, or with the temperature inside the skin. Strength in counts."""

    parts: tuple[float, ...] = (1.0,) * TAXELS
    start_s: float = 60.0
    warm: bool = False

    name = "baseline_drift"
    stage = Stage.CONVERTER
    typical = 1.5

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Effect:
        """See :meth:`Effect.draw`."""
        warm = bool(rng.uniform() < 0.35)
        parts = np.ones(TAXELS) if warm else rng.gamma(3.0, 1 / 3.0, TAXELS)
        return cls(cls.typical, tuple(parts.tolist()), float(rng.uniform(30, 300)), warm)

    def signal(self, x: Floats, scene: Scene) -> Floats:
        """See :meth:`Effect.signal`."""
        if self.warm:
            way = _warmth(scene, 15.0)
        else:
            way = np.log1p(scene.line.time_s / self.start_s) / np.log1p(scene.length_s / self.start_s)
        return x + self.strength * way[:, None] * np.array(self.parts)


@dataclass(frozen=True)
class GainDrift(Effect):
    """Wear, ``y = x / (1 + a (t / T)^p)``; its reverse for a < 0; or Arrhenius' law with the skin's temperature."""

    power: float = 1.0
    warm: bool = False

    name = "gain_drift"
    typical = 0.1
    largest = 1.5

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Effect:
        """See :meth:`Effect.draw`."""
        sign = 1.0 if rng.uniform() < 0.7 else -0.6
        return cls(cls.typical * sign, float(rng.uniform(0.6, 1.4)), bool(rng.uniform() < 0.35))

    def signal(self, x: Floats, scene: Scene) -> Floats:
        """See :meth:`Effect.signal`."""
        if self.warm:
            start = float(scene.temperature_c[0]) + _CELSIUS_K
            way = start * (1 - start / (start + _warmth(scene, 15.0)))
            return x * np.exp(self.strength * way)[:, None]
        change = (1 + abs(self.strength) * (scene.line.time_s / scene.length_s) ** self.power)[:, None]
        return x / change if self.strength > 0 else x * change
