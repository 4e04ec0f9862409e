"""Interface of a hidden effect: its hooks into the signal chain, and the scene that they get."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from enum import IntEnum
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from benchmarks.blind.truth.body import Body, ContactChange, Touches
from benchmarks.blind.truth.protocol import Plan, Timeline
from benchmarks.blind.truth.rig import RATE_HZ, Floats, Ints


class Stage(IntEnum):
    """Stages of the signal chain, in their order."""

    LOADS = 0
    MEMORY = 1
    TRANSFER = 2
    COUPLING = 3
    CONVERTER = 4


@dataclass(frozen=True, eq=False)
class Scene:
    """A session without noise, sample by sample.

    Attributes:
        body: the sensor.
        plan: presses.
        line: the clock.
        touches: what touches where, as measured, were there no error (N,).
        shear_n: tangential force round and along the finger (N, 2) [N].
        temperature_c: (N,).
    """

    body: Body
    plan: Plan
    line: Timeline
    touches: Touches
    shear_n: Floats
    temperature_c: Floats

    @property
    def touching(self) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """Mask of the samples that belong to a press (N,)."""
        return self.line.press >= 0

    def of_press(self, column: Floats) -> Floats:
        """A number of every press, for every sample."""
        return column[self.line.near]

    @cached_property
    def pose(self) -> Ints:
        """Hand pose of every sample (N,)."""
        return self.of_press(self.plan.column("pose")).astype(np.int64)

    @cached_property
    def by_press(self) -> list[Ints]:
        """Rows of the samples of every press."""
        return [np.flatnonzero(self.line.press == k) for k in range(len(self.plan.presses))]

    @property
    def length_s(self) -> float:
        """Duration of the session [s]."""
        return float(self.line.time_s[-1])


@dataclass(frozen=True)
class Effect:
    """A hidden effect; without strength there is nothing.

    A subclass overrides the hooks that it needs. ``typical`` is a strength to start a search from, ``largest`` where
    it ends; ``in_positions`` and ``places_held`` say how g is measured (:mod:`benchmarks.blind.truth.strength`).
    """

    strength: float

    name: ClassVar[str] = ""
    stage: ClassVar[Stage] = Stage.TRANSFER
    typical: ClassVar[float] = 0.1
    largest: ClassVar[float] = np.inf
    in_positions: ClassVar[bool] = False
    places_held: ClassVar[bool] = False

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Effect:
        """Its form by chance, at its typical strength."""
        del rng
        return cls(cls.typical)

    def touches(self, touches: Touches, scene: Scene) -> Touches:
        """Return the true contacts for the measured ones."""
        del scene
        return touches

    def change(self) -> ContactChange | None:
        """Return the change of the contact itself."""
        return None

    def moves(self, scene: Scene) -> Floats | None:
        """Return the taxels' displacements round and along the finger (N, J, 2) [m]."""
        del scene
        return None

    def reported(self, scene: Scene) -> Floats:
        """Return the offsets of every press's measured position, round and along the finger (K, 2) [m]."""
        return np.zeros((len(scene.plan.presses), 2))

    def signal(self, x: Floats, scene: Scene) -> Floats:
        """Counts (N, J) at the stage of the effect."""
        del scene
        return x

    def plain(self) -> Mapping[str, Any]:
        """Its parameters, for the label."""
        return {
            f.name: v.tolist() if isinstance(v := getattr(self, f.name), np.ndarray) else v
            for f in fields(self)
        }


def lagged(x: Floats, time_s: float) -> Floats:
    """A first-order lag of a signal (N, ...) sampled at 25 Hz, from rest."""
    from scipy.signal import lfilter

    stay = float(np.exp(-1 / (RATE_HZ * max(time_s, 1e-9))))
    return lfilter([1 - stay], [1, -stay], x, axis=0)
