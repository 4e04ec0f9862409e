"""Effects that the catalogue lacks; a diagnosis should report them as unknown."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from benchmarks.blind.truth.body import Touches
from benchmarks.blind.truth.effect import Effect, Scene, Stage
from benchmarks.blind.truth.protocol import HOLD, IDLE
from benchmarks.blind.truth.rig import COLS, ROWS, TAXEL_UV_M, TAXELS, Floats

_CENTIMETRE_M = 0.01
_RIGHT = np.tile(np.arange(COLS) >= COLS // 2, ROWS)


class Outside(Effect):
    """An effect that the catalogue does not have."""

    name = "not in the catalogue"


@dataclass(frozen=True)
class Bending(Outside):
    """In the second hand pose the patch is bent: taxels move with the square of their place. Strength in mm at 1 cm."""

    typical = 0.5
    largest = 6.0

    def moves(self, scene: Scene) -> Floats:
        """See :meth:`Effect.moves`."""
        u, v = (TAXEL_UV_M / _CENTIMETRE_M).T
        bent = 1e-3 * self.strength * np.column_stack([v**2 - np.mean(v**2), u * v])
        return scene.pose[:, None, None] * bent


@dataclass(frozen=True)
class Product(Outside):
    """A coupling that grows with the load: ``y_j = x_j + a x_j (sum of the diagonal neighbours) / 60``."""

    typical = 0.2
    largest = 3.0
    stage = Stage.COUPLING

    def signal(self, x: Floats, scene: Scene) -> Floats:
        """See :meth:`Effect.signal`."""
        del scene
        row, column = np.divmod(np.arange(TAXELS), COLS)
        diagonal = (np.abs(row[:, None] - row) == 1) & (np.abs(column[:, None] - column) == 1)
        return x * (1 + self.strength * (x @ diagonal.astype(np.float64)) / 60)


@dataclass(frozen=True)
class Breathing(Outside):
    """The gain beats: ``y = x (1 + a sin(2 pi t / P))``, as two clocks or two supplies do."""

    period_s: float = 8.0

    typical = 0.1
    largest = 0.9

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Effect:
        """See :meth:`Effect.draw`."""
        return cls(cls.typical, float(rng.uniform(3, 20)))

    def signal(self, x: Floats, scene: Scene) -> Floats:
        """See :meth:`Effect.signal`."""
        return x * (1 + self.strength * np.sin(2 * np.pi * scene.line.time_s / self.period_s))[:, None]


@dataclass(frozen=True)
class Wander(Outside):
    """Half of the patch has come loose and slides with the square of the tangential force. Strength in mm at 1 N."""

    typical = 1.0
    largest = 6.0

    def moves(self, scene: Scene) -> Floats:
        """See :meth:`Effect.moves`."""
        across, along = scene.shear_n.T
        size = np.maximum(np.hypot(across, along), 1e-9)
        # Bounded, as what holds it does not let it go for ever.
        way = 1e-3 * np.tanh(size) / size * self.strength
        square = np.column_stack([across**2 - along**2, 2 * across * along])
        return (way / np.maximum(size, 0.3))[:, None, None] * square[:, None] * _RIGHT[None, :, None]


@dataclass(frozen=True)
class AfterImage(Outside):
    """Add a fading part of the last hold's image to the next press."""

    fade_s: float = 5.0

    typical = 0.1
    largest = 1.5
    stage = Stage.MEMORY

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Effect:
        """See :meth:`Effect.draw`."""
        return cls(cls.typical, float(rng.uniform(3, 10)))

    def signal(self, x: Floats, scene: Scene) -> Floats:
        """See :meth:`Effect.signal`."""
        holds = [x[rows[scene.line.phase[rows] == HOLD]].mean(axis=0) for rows in scene.by_press]
        last = np.vstack([np.zeros((1, x.shape[1])), holds[:-1]])[scene.line.near]
        since = np.r_[-np.inf, scene.plan.times_s[:-1, 3]][scene.line.near]
        fading = np.exp(-(scene.line.time_s - since) / self.fade_s) * (scene.line.phase != IDLE)
        return x + self.strength * fading[:, None] * last


@dataclass(frozen=True)
class Tear(Outside):
    """The skin is torn down the middle: load on one side, above a threshold, takes gain from the other."""

    threshold_counts: float = 10.0

    typical = 0.2
    largest = 5.0
    stage = Stage.COUPLING

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Effect:
        """See :meth:`Effect.draw`."""
        return cls(cls.typical, float(rng.uniform(5, 20)))

    def signal(self, x: Floats, scene: Scene) -> Floats:
        """See :meth:`Effect.signal`."""
        del scene
        sides = np.column_stack([x[:, ~_RIGHT].sum(axis=1), x[:, _RIGHT].sum(axis=1)])
        above = np.maximum(sides - self.threshold_counts, 0.0) / 30.0
        gain = 1 / (1 + self.strength * above)
        return x * np.where(_RIGHT, gain[:, :1], gain[:, 1:])


@dataclass(frozen=True)
class Steps(Outside):
    """From some moment on the converter has steps of several counts. Strength: their height in counts."""

    part: float = 0.4

    typical = 4.0
    largest = 12.0
    stage = Stage.CONVERTER

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Effect:
        """See :meth:`Effect.draw`."""
        return cls(cls.typical, float(rng.uniform(0.2, 0.5)))

    def signal(self, x: Floats, scene: Scene) -> Floats:
        """See :meth:`Effect.signal`."""
        late = (scene.line.time_s >= self.part * scene.length_s)[:, None]
        return np.where(late, self.strength * np.round(x / self.strength), x)


@dataclass(frozen=True)
class Snap(Outside):
    """Above a force the skin buckles and the image jumps aside, until the force is half of that. Strength in mm."""

    threshold_n: float = 2.0
    way: tuple[float, float] = (1.0, 0.0)

    typical = 0.4
    largest = 3.0

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Effect:
        """See :meth:`Effect.draw`."""
        turn = rng.uniform(0, 2 * np.pi)
        return cls(cls.typical, float(rng.uniform(1.2, 2.2)), (float(np.cos(turn)), float(np.sin(turn))))

    def touches(self, touches: Touches, scene: Scene) -> Touches:
        """See :meth:`Effect.touches`."""
        over = np.zeros(len(touches.force_n))
        for rows in scene.by_press:
            force = touches.force_n[rows]
            reached = np.maximum.accumulate(force) >= self.threshold_n
            over[rows] = reached & (force >= self.threshold_n / 2)
        move = 1e-3 * self.strength * over
        return touches.moved(self.way[0] * move, self.way[1] * move)


OUTSIDE: dict[str, type[Effect]] = {
    "bending": Bending,
    "product": Product,
    "breathing": Breathing,
    "wander": Wander,
    "after_image": AfterImage,
    "tear": Tear,
    "steps": Steps,
    "snap": Snap,
}
"""The kinds by name."""
