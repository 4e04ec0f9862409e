"""Parameters of effects as a plain vector to be searched: every number in units in which it is about one.

A strength is counted from neutral in typical values, a form from its start on a logarithmic scale, or in thirds of
its range. Each has a broad Gaussian prior about zero, so that numbers which the data do not know stay where they were.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from skincal.effects import Effect, EffectParameter
from skincal.model.arrays import BoolArray, FloatArray

_OF_RANGE = 0.02
"""The typical value of a strength that no typical case has, in parts of its range."""
_FORM_RANGE = 0.3
STRENGTH_PRIOR, FORM_PRIOR = 3.0, 1.5
"""Standard deviations of the priors."""


@dataclass(frozen=True)
class Coordinate:
    """One number of one effect.

    Attributes:
        effect: its name.
        parameter: that the number belongs to.
        index: taxel or pose; 0 for a parameter that is one number.
        size: how many numbers the parameter has.
        start: value at which the coordinate is zero.
        scatter: standard deviation of the prior, in units; None: the broad one of its role.
    """

    effect: str
    parameter: EffectParameter
    index: int
    size: int
    start: float
    scatter: float | None = None

    @property
    def is_strength(self) -> bool:
        """Whether it brings the effect in."""
        return self.parameter.role == "strength"

    @cached_property
    def unit(self) -> float:
        """What one stands for, on the scale of the parameter."""
        p = self.parameter
        if self.is_strength:
            return abs(p.typical) or _OF_RANGE * (p.high - p.low)
        return 1.0 if p.scale == "log" else _FORM_RANGE * (p.high - p.low)

    @property
    def prior(self) -> float:
        """Standard deviation of the prior, in units."""
        broad = STRENGTH_PRIOR if self.is_strength else FORM_PRIOR
        return broad if self.scatter is None else self.scatter

    def value(self, x: float) -> float:
        """The parameter at a coordinate, within its bounds."""
        p = self.parameter
        logarithmic = not self.is_strength and p.scale == "log"
        # Plain numbers, not arrays: a fit asks a million times.
        low, high = self.bounds
        x = min(max(x, low), high)
        raw = self.start * math.exp(x) if logarithmic else self.start + x * self.unit
        return min(max(raw, p.low), p.high)

    def at(self, value: float) -> float:
        """The coordinate of a parameter's value."""
        p = self.parameter
        if not self.is_strength and p.scale == "log":
            return float(np.log(value / self.start))
        return (value - self.start) / self.unit

    @cached_property
    def bounds(self) -> tuple[float, float]:
        """Least and largest coordinate."""
        p = self.parameter
        if not self.is_strength and p.scale == "log":
            return float(np.log(p.low / self.start)), float(np.log(p.high / self.start))
        return (p.low - self.start) / self.unit, (p.high - self.start) / self.unit


def coordinates(
    effect: Effect,
    sizes: Mapping[str, int],
    lacking: Sequence[str] = (),
    forms: Mapping[str, float] | None = None,
) -> tuple[Coordinate, ...]:
    """All numbers of an effect that data with these covariates can speak of; none if the effect needs what is lacking.

    Args:
        effect: of the registry.
        sizes: numbers that a ``scalar``, ``per-taxel`` and ``per-pose`` parameter has.
        lacking: covariates that are not there.
        forms: starts of forms; their defaults where not given.
    """
    if set(effect.covariates) & set(lacking):
        return ()
    usable = [p for p in effect.parameters if not set(p.needs) & set(lacking)]
    return tuple(
        Coordinate(effect.name, p, i, sizes[p.shape], (forms or {}).get(p.name, p.neutral))
        for p in usable
        for i in range(sizes[p.shape])
    )


def parameters_at(
    coords: Sequence[Coordinate], x: FloatArray, held: Mapping[str, Mapping[str, FloatArray]] | None = None
) -> dict[str, dict[str, FloatArray]]:
    """Parameters by effect at coordinates (n,), beside those that are held where they are."""
    found = {name: {key: np.array(v) for key, v in own.items()} for name, own in (held or {}).items()}
    for coordinate, at in zip(coords, x.tolist(), strict=True):
        own, p = found.setdefault(coordinate.effect, {}), coordinate.parameter
        if p.shape == "scalar":
            own[p.name] = np.asarray(coordinate.value(at))
        else:
            own.setdefault(p.name, np.full(coordinate.size, p.neutral))[coordinate.index] = coordinate.value(
                at
            )
    return found


def coordinates_at(
    coords: Sequence[Coordinate], parameters: Mapping[str, Mapping[str, FloatArray]]
) -> FloatArray:
    """Coordinates (n,) of parameters by effect: the inverse of :func:`parameters_at`, zero where one is not given."""
    found = np.zeros(len(coords))
    for k, c in enumerate(coords):
        given = parameters.get(c.effect, {}).get(c.parameter.name)
        if given is not None:
            found[k] = c.at(float(np.broadcast_to(given, c.size)[c.index]))
    return clipped(coords, found)


def strengths(coords: Sequence[Coordinate]) -> BoolArray:
    """(n,) which coordinates bring an effect in."""
    return np.array([c.is_strength for c in coords], dtype=np.bool_)


def priors(coords: Sequence[Coordinate]) -> FloatArray:
    """(n,) standard deviations of the priors."""
    return np.array([c.prior for c in coords])


def clipped(coords: Sequence[Coordinate], x: FloatArray) -> FloatArray:
    """Coordinates (n,) within their bounds."""
    bounds = np.array([c.bounds for c in coords]).reshape(-1, 2)
    return np.clip(x, bounds[:, 0], bounds[:, 1])


def room(coords: Sequence[Coordinate], x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """How far coordinates (n,) may go down, at most zero, and up, at least zero, from where they are within bounds."""
    bounds = np.array([c.bounds for c in coords], dtype=np.float64).reshape(-1, 2)
    return np.minimum(bounds[:, 0] - x, 0.0), np.maximum(bounds[:, 1] - x, 0.0)


def names(coords: Sequence[Coordinate]) -> tuple[str, ...]:
    """Names of coordinates, with their taxel or pose."""
    return tuple(
        c.parameter.name if c.parameter.shape == "scalar" else f"{c.parameter.name}[{c.index}]"
        for c in coords
    )
