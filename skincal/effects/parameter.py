"""Parameters of effects, checked values of them, and where a search for them starts."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from skincal.model.arrays import FloatArray

Shape = Literal["scalar", "per-taxel", "per-pose"]
Role = Literal["strength", "form", "onset"]
Scale = Literal["linear", "log"]

MOST_COUNTS = 1e12
"""Bound of parameters in units of taxel values: counts, volts or pascals, whatever a sensor has."""

TYPICAL_TOP_COUNTS = 100.0
"""Large value above rest of the sensor that typical cases in counts are meant for."""


@dataclass(frozen=True)
class EffectParameter:
    """A parameter of an effect.

    Attributes:
        name: name with its unit: ``time_constant_s``.
        unit: unit for display; ``-`` for a plain number.
        neutral: with all strengths at this value the effect has no influence. For a form: its default.
        low: smallest value.
        high: largest value.
        description: meaning in a few words.
        typical: distance from neutral of a clearly visible case; 0 if such a case does not need it.
        shape: one number, one for each taxel, or one for each hand pose.
        role: ``strength`` if it makes the effect act, ``form`` if it only shapes it, ``onset`` if it is the moment [s]
            from which on it acts: what it does has no slope by that.
        needs: covariates that are needed if it is not neutral.
        scale: the scale on which to fit and to draw it.
    """

    name: str
    unit: str
    neutral: float
    low: float
    high: float
    description: str
    typical: float = 0.0
    shape: Shape = "scalar"
    role: Role = "strength"
    needs: tuple[str, ...] = ()
    scale: Scale = "linear"

    @property
    def counts_power(self) -> int:
        """Power of the unit of taxel values in its unit: by so much it follows a change of that unit."""
        return 1 if self.unit.startswith("counts") else -1 if self.unit.endswith("/counts") else 0

    def typical_at(self, top_counts: float) -> float:
        """The distance from neutral of a clearly visible case on a sensor with some large value above rest [counts]."""
        return self.typical * (top_counts / TYPICAL_TOP_COUNTS) ** self.counts_power

    def fault(self, value: ArrayLike, taxels: int = 0, poses: int = 0) -> tuple[str, str] | None:
        """Return what was expected of a value, and what came; None if it is valid.

        Args:
            value: one number, or one for each taxel or pose.
            taxels: number of taxels J; 0: not known.
            poses: number of hand poses; 0: not known.
        """
        array = np.asarray(value, dtype=np.float64)
        count, of = {"scalar": (1, ""), "per-taxel": (taxels, "taxel"), "per-pose": (poses, "of the poses")}[
            self.shape
        ]
        if (
            array.ndim > (self.shape != "scalar")
            or not array.size
            or (count and array.size not in (1, count))
        ):
            several = f", or {count or 'a list'}, one for each {of}" if of else ""
            return f"one number{several}", f"an array of shape {array.shape}"
        outside = np.atleast_1d(array)[~np.atleast_1d((array >= self.low) & (array <= self.high))]
        return (f"{self.low:g} to {self.high:g} {self.unit}", f"{outside[0]:g}") if outside.size else None


strength = EffectParameter
"""A parameter that makes the effect act."""
per_taxel = partial(strength, shape="per-taxel")
per_pose = partial(strength, shape="per-pose", needs=("pose",))
form = partial(EffectParameter, role="form")
"""A parameter that only shapes the effect."""
onset = partial(EffectParameter, role="onset")
"""The moment from which on the effect acts."""


class Values(Mapping[str, FloatArray]):
    """Checked parameters of an effect by name: read-only arrays, () for one number, (J,) or (poses,) for more."""

    def __init__(self, arrays: Mapping[str, FloatArray]) -> None:
        """Store arrays that :meth:`skincal.effects.effect.Effect.checked` has checked."""
        self._arrays = dict(arrays)

    def __getitem__(self, name: str) -> FloatArray:
        return self._arrays[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._arrays)

    def __len__(self) -> int:
        return len(self._arrays)

    def __repr__(self) -> str:
        return f"Values({ {name: array.tolist() for name, array in self._arrays.items()} })"

    def number(self, name: str) -> float:
        """Return a parameter that is one number."""
        return float(self._arrays[name])

    @property
    def key(self) -> tuple[tuple[str, tuple[int, ...], bytes], ...]:
        """Hashable key, equal for equal values."""
        return tuple((name, array.shape, array.tobytes()) for name, array in self._arrays.items())


@dataclass(frozen=True)
class Scene:
    """Scales of a session, so that starting points lie where an effect is visible.

    Attributes:
        taxels: number of taxels J.
        poses: number of hand poses.
        top_counts: a large value above rest [counts].
        top_n: a large load on a taxel [N].
        force_n: a medium force [N].
        duration_s: length of the session [s].
        speed_m_per_s: a medium speed.
    """

    taxels: int
    poses: int
    top_counts: float
    top_n: float
    force_n: float
    duration_s: float
    speed_m_per_s: float = 1e-3


@dataclass(frozen=True)
class Start:
    """Starting point of a search: the effect is sought in the span of some points, each a set of parameters.

    Attributes:
        points: parameters by name; omitted ones are neutral or default. All have the same forms.
        sigma: prior standard deviation of the multiple of each point.
        alone: no other start of the effect has the same taxel, so that several may act at once (one dead taxel each).
    """

    points: tuple[Mapping[str, FloatArray], ...]
    sigma: tuple[float, ...]
    alone: int | None = None


def start(*points: Mapping[str, ArrayLike], sigma: float = 1.0, alone: int | None = None) -> Start:
    """Return a start of some points, which all have the same prior standard deviation."""
    arrays = tuple({k: np.asarray(v, dtype=np.float64) for k, v in p.items()} for p in points)
    return Start(arrays, (sigma,) * len(points), alone)


def each_of(name: str, step: float, count: int, neutral: float = 0.0) -> list[Mapping[str, ArrayLike]]:
    """Return a point for each of several numbers of a parameter, a step away from neutral."""
    return [{name: neutral + row} for row in step * np.eye(count)]
