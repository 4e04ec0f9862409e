"""Hidden effects between load and counts: saturation, dead band, response curve, stiffening, a cover."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from benchmarks.blind.truth.body import ContactChange, Touches
from benchmarks.blind.truth.contact import Hardening
from benchmarks.blind.truth.effect import Effect, Scene, Stage
from benchmarks.blind.truth.rig import Floats


@dataclass(frozen=True)
class Saturation(Effect):
    """The smaller of value and ceiling, rounded off: ``y = C - w log(1 + exp((C - x) / w))``, or ``C tanh(x / C)``.

    Strength is 100 counts over the ceiling.
    """

    rounding: float = 0.1
    gradual: bool = False

    name = "saturation"
    stage = Stage.CONVERTER
    typical = 1.5
    largest = 3.0

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Effect:
        """See :meth:`Effect.draw`."""
        return cls(cls.typical, float(rng.uniform(0.02, 0.2)), bool(rng.uniform() < 0.4))

    def signal(self, x: Floats, scene: Scene) -> Floats:
        """See :meth:`Effect.signal`."""
        del scene
        ceiling = 100.0 / max(self.strength, 1e-6)
        if self.gradual:
            return np.where(x > 0, ceiling * np.tanh(x / ceiling), x)
        width = self.rounding * ceiling
        left = width * np.logaddexp(0.0, ceiling / width) - width * np.logaddexp(0.0, (ceiling - x) / width)
        return np.where(x > 0, left, x)


@dataclass(frozen=True)
class DeadBand(Effect):
    """A hinge at b that is a parabola from b - w to b + w, with w a part of b. Strength b in counts."""

    rounding: float = 0.3

    name = "dead_band"
    stage = Stage.CONVERTER
    typical = 4.0

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Effect:
        """See :meth:`Effect.draw`."""
        return cls(cls.typical, float(rng.uniform(0.05, 1.0)))

    def signal(self, x: Floats, scene: Scene) -> Floats:
        """See :meth:`Effect.signal`."""
        del scene
        band = self.strength
        width = self.rounding * band

        bent = np.clip(x - band + width, 0.0, 2 * width) ** 2 / max(4 * width, 1e-12)
        return np.where(x > 0, bent + np.maximum(x - band - width, 0.0), x)


@dataclass(frozen=True)
class ResponseCurve(Effect):
    """Bent by an area hyperbolic sine, straight where it begins, or from one slope to another.

    With ``z = x / x1`` and strength a: ``y = x1 asinh(a z) / a`` (a < 0: ``x1 sinh(a z) / a``), or, for two slopes,
    ``y = x1 (b z + (1 - b) (1 - exp(-z)))`` with ``b = 1 / (1 + a)`` (a < 0: ``b = 1 - a``).
    """

    reference_counts: float = 60.0
    two_slopes: bool = False

    name = "response_curve"
    typical = 0.5
    largest = 12.0

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Effect:
        """See :meth:`Effect.draw`."""
        sign = 1.0 if rng.uniform() < 0.65 else -0.4
        two = bool(rng.uniform() < 0.5)
        return cls(cls.typical * sign, float(rng.uniform(15, 40) if two else rng.uniform(50, 100)), two)

    def signal(self, x: Floats, scene: Scene) -> Floats:
        """See :meth:`Effect.signal`."""
        del scene
        z, a = np.maximum(x, 0.0) / self.reference_counts, self.strength
        if self.two_slopes:
            slope = 1 / (1 + a) if a > 0 else 1 - a
            bent = slope * z - (1 - slope) * np.expm1(-z)
        elif a:
            # No load is beyond 10 of these.
            bent = (np.arcsinh(a * z) if a > 0 else np.sinh(np.maximum(a * z, -10.0))) / a
        else:
            bent = z
        return np.where(x > 0, self.reference_counts * bent, x)


@dataclass(frozen=True)
class Stiffening(Effect):
    """Fung's exponential law of the penetration; strength is 1 mm over its depth, below zero the skin gives way."""

    name = "stiffening"
    typical = 0.7
    largest = 2.0

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Effect:
        """See :meth:`Effect.draw`."""
        return cls(cls.typical * (1.0 if rng.uniform() < 0.7 else -1.0))

    def change(self) -> ContactChange:
        """See :meth:`Effect.change`."""
        return ContactChange(hardening=Hardening(1e-3 / self.strength) if self.strength else None)


@dataclass(frozen=True)
class Cover(Effect):
    """A glove carries ``k F / (1 + F / F0)`` of the force."""

    force_n: float = 0.6

    name = "cover"
    typical = 0.3
    largest = 0.95

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Effect:
        """See :meth:`Effect.draw`."""
        return cls(cls.typical, float(rng.uniform(0.6, 2.0)))

    def touches(self, touches: Touches, scene: Scene) -> Touches:
        """See :meth:`Effect.touches`."""
        del scene
        carried = self.strength * touches.force_n / (1 + touches.force_n / self.force_n)
        return replace(touches, force_n=touches.force_n - carried)
