"""Hidden effects of single taxels: gain, offset, death."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from benchmarks.blind.truth.between import neighbours
from benchmarks.blind.truth.effect import Effect, Scene, Stage
from benchmarks.blind.truth.rig import TAXELS, TOP_COUNTS, Floats


@dataclass(frozen=True)
class TaxelGain(Effect):
    """Gains with a few outliers, which bend a little: ``y = x (1 + e_j) (1 + e_j x / 600)``."""

    parts: tuple[float, ...] = (0.0,) * TAXELS

    name = "taxel_gain"
    typical = 0.08
    largest = 1.0

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Effect:
        """See :meth:`Effect.draw`."""
        parts = np.clip(rng.standard_t(5, TAXELS), -2.5, 2.5)
        return cls(cls.typical, tuple((parts - parts.mean()).tolist()))

    def signal(self, x: Floats, scene: Scene) -> Floats:
        """See :meth:`Effect.signal`."""
        del scene
        off = np.clip(self.strength * np.array(self.parts), -0.8, 3.0)
        return x * (1 + off) * (1 + off * x / 600)


@dataclass(frozen=True)
class TaxelOffset(Effect):
    """A current beside the taxel that takes a part of the range: ``y = x + o_j (1 - x / 255)``. Strength in counts."""

    parts: tuple[float, ...] = (1.0,) * TAXELS

    name = "taxel_offset"
    stage = Stage.CONVERTER
    typical = 1.0

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Effect:
        """See :meth:`Effect.draw`."""
        return cls(cls.typical, tuple(rng.exponential(1.0, TAXELS).tolist()))

    def signal(self, x: Floats, scene: Scene) -> Floats:
        """See :meth:`Effect.signal`."""
        del scene
        return x + self.strength * np.array(self.parts) * (1 - x / TOP_COUNTS)


@dataclass(frozen=True)
class DeadTaxel(Effect):
    """An open line: one or two taxels read a twentieth of their neighbours. Strength: for which part of the session."""

    taxels: tuple[int, ...] = (5,)
    pick_up: float = 0.05

    name = "dead_taxel"
    stage = Stage.CONVERTER
    typical = 0.5
    largest = 1.0
    places_held = True

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Effect:
        """See :meth:`Effect.draw`."""
        count = 1 if rng.uniform() < 0.7 else 2
        chosen = rng.choice(TAXELS, count, replace=False)
        return cls(cls.typical, tuple(int(k) for k in chosen), float(rng.uniform(0.0, 0.05)))

    def signal(self, x: Floats, scene: Scene) -> Floats:
        """See :meth:`Effect.signal`."""
        late = scene.line.time_s >= (1 - min(self.strength, 1.0)) * scene.length_s
        near = neighbours()
        picked = self.pick_up * x @ (near / near.sum(axis=0))
        y = x.copy()
        for taxel in self.taxels:
            y[late, taxel] = picked[late, taxel]
        return y
