"""Slopes by the parameters of effects, in the model or candidates for it, by differences of the effects' equations.

A per-taxel parameter changes only its own taxel where no later stage mixes taxels. One run of the chain then gives the
slopes of all taxels, each kept at its own taxel (:mod:`skincal.inference.slopes`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from skincal.effects import EffectParameter, Stage, effect
from skincal.effects.parameter import Scene, Start
from skincal.inference.forward import Effects, Forward, StatePrediction
from skincal.inference.slopes import Slopes
from skincal.model.arrays import FloatArray

_LOG_STEP, _LINEAR_STEP = 0.03, 0.01


@dataclass(frozen=True)
class FreeParameter:
    """One fitted number of an effect.

    Attributes:
        effect: name of the effect.
        parameter: which of its parameters.
        index: taxel or pose; None for a scalar.
        sigma: standard deviation of the prior, on the parameter's own scale.
        middle: mean of the prior, on the same scale.
    """

    effect: str
    parameter: EffectParameter
    index: int | None
    sigma: float
    middle: float

    @property
    def logarithmic(self) -> bool:
        """True if its logarithm is fitted."""
        return self.parameter.scale == "log"

    def get(self, effects: Effects) -> float:
        """Return its value in some effects, on its own scale."""
        value = float(np.asarray(effects[self.effect][self.parameter.name]).ravel()[self.index or 0])
        return float(np.log(value)) if self.logarithmic else value

    def bounds(self) -> tuple[float, float]:
        """Return its bounds, on its own scale."""
        p = self.parameter
        return (float(np.log(p.low)), float(np.log(p.high))) if self.logarithmic else (p.low, p.high)

    def clipped(self, value: float) -> float:
        """Return a value clipped to its bounds."""
        low, high = self.bounds()
        return min(max(value, low), high)


def with_values(
    effects: Effects, free: Sequence[FreeParameter], values: FloatArray
) -> dict[str, dict[str, FloatArray]]:
    """Return effects with some numbers set, given on their own scales and clipped to their bounds."""
    out = {n: {k: np.array(v, dtype=np.float64) for k, v in own.items()} for n, own in effects.items()}
    for f, value in zip(free, values, strict=True):
        own = float(np.exp(value)) if f.logarithmic else float(value)
        own = min(max(own, f.parameter.low), f.parameter.high)
        array = out[f.effect][f.parameter.name]
        if array.ndim:
            array[f.index or 0] = own
        else:
            out[f.effect][f.parameter.name] = np.asarray(own)
    return out


def free_parameters(
    name: str, values: Mapping[str, FloatArray], first: Start | None, covariates: frozenset[str]
) -> list[FreeParameter]:
    """List the fitted numbers of an effect: the strengths that its start changes, and its forms.

    Args:
        name: of the effect.
        values: its present parameters.
        first: start of a candidate; None for an effect of the calibration, whose strengths off neutral are fitted.
        covariates: names of those that the session has.
    """
    found: list[FreeParameter] = []
    if first is None:
        away = {
            p.name: np.asarray(values[p.name])
            for p in effect(name).parameters
            if p.role == "strength" and p.name in values
        }
        first = Start(
            tuple({k: v} for k, v in away.items() if (v != effect(name).parameter(k).neutral).any()), ()
        )
    moved = {k for p in first.points for k in p}
    own = effect(name)
    for p in own.parameters:
        if p.name not in values or p.role == "onset" or not set(p.needs) <= covariates:
            continue
        if p.role == "strength" and p.name not in moved:
            continue
        array = np.asarray(values[p.name])
        if p.role == "form" and array.ndim and first.alone is None:
            continue
        sized = [
            sigma * float(np.abs(np.asarray(point[p.name]) - p.neutral).max())
            for point, sigma in zip(first.points, first.sigma or (1.0,) * len(first.points), strict=True)
            if p.name in point
        ]
        scale = max(sized, default=0.0) or p.typical or 1.0
        for i in range(array.size) if array.ndim else (None,):
            if array.ndim and first.alone is not None and i != first.alone:
                continue
            if p.role == "form":
                at = float(array.ravel()[i or 0])
                middle = float(np.log(at)) if p.scale == "log" else at
                sigma = 1.0 if p.scale == "log" else (p.high - p.low) / 4
                sigma = max(3 * scale, abs(at)) if p.counts_power else sigma
            else:
                middle = float(np.log(p.neutral)) if p.scale == "log" else p.neutral
                sigma = max(float(np.log1p(scale)) if p.scale == "log" else scale, 1e-12) * 3
            found.append(FreeParameter(name, p, i, sigma, middle))
    return found


def is_local(name: str, others: Effects) -> bool:
    """Return whether an effect changes a taxel only by that taxel's own load: no later stage mixes taxels."""
    stage = effect(name).stage
    mixed = any(effect(n).stage == Stage.CROSSTALK for n in others)
    return stage > Stage.CROSSTALK or (stage >= Stage.TRANSFER and stage != Stage.CROSSTALK and not mixed)


def free_columns(
    forward: Forward, prediction: StatePrediction, free: Sequence[FreeParameter]
) -> list[Slopes]:
    """Compute the slopes over K samples by fitted numbers of effects in the model, each on its own scale."""
    now, taxels = prediction.state.effects, prediction.values.shape[1]
    at = np.array([f.get(now) for f in free])
    out: list[Slopes] = [Slopes.of(np.zeros((0, 0, 0)))] * len(free)
    local = [f.parameter.shape == "per-taxel" and is_local(f.effect, now) for f in free]
    groups: dict[object, list[int]] = {}
    for k, f in enumerate(free):
        groups.setdefault((f.effect, f.parameter.name) if local[k] else k, []).append(k)
    for members in groups.values():
        steps = np.array([_step(free[k], at[k]) for k in members])
        some = [free[k] for k in members]
        changed = with_values(now, some, at[members] + steps)
        difference = forward.with_effects(prediction, changed) - prediction.values
        for k, step in zip(members, steps, strict=True):
            j = free[k].index
            if local[k] and j is not None:
                out[k] = Slopes.of_taxel(difference[:, j] / step, j, taxels)
            else:
                out[k] = Slopes.of(difference[..., None] / step)
    return out


def _step(f: FreeParameter, at: float) -> float:
    _, high = f.bounds()
    p = f.parameter
    size = f.sigma / 3 if p.counts_power else p.typical or (p.high - p.low) / 4
    step = _LOG_STEP if f.logarithmic else _LINEAR_STEP * size
    step = abs(step) if not p.shape.startswith("per") else max(abs(step), 1e-9)
    return -step if at + step > high else step


@dataclass(frozen=True, eq=False)
class Candidate:
    """An effect at one of its starts, linearised.

    Attributes:
        name: of the effect.
        start: point in its parameters to begin at.
        columns: n slopes of observations, one for each point of the start.
    """

    name: str
    start: Start
    columns: Slopes

    @property
    def key(self) -> tuple[str, int | None]:
        """Name and taxel; equal for starts of the same thing."""
        return self.name, self.start.alone


def candidates(
    forward: Forward,
    prediction: StatePrediction,
    scene: Scene,
    slope: FloatArray,
    names: Sequence[str],
    had: set[tuple[str, int | None]],
) -> Iterator[Candidate]:
    """Yield every start of the effects whose covariates are there, with its columns.

    Args:
        forward: the model.
        prediction: present state and its prediction.
        scene: scale of the session.
        slope: (K, J) of the converter.
        names: effects that may be missing.
        had: effects, or single taxels of them, that the model has already.
    """
    skip = {n for n, alone in had if alone is None}
    wanted = [(n, s) for n in names if n not in skip for s in starts_of(n, scene) if (n, s.alone) not in had]
    taxels = prediction.values.shape[1]
    have = {n: dict(own) for n, own in prediction.state.effects.items()}
    found: list[list[Slopes]] = [[] for _ in wanted]
    runs: dict[object, list[tuple[int, int, int | None]]] = {}
    turns: Counter[object] = Counter()
    for w, (name, s) in enumerate(wanted):
        local = is_local(name, have) and not effect(name).has_memory
        found[w] = [Slopes.of(np.zeros((0, 0, 0)))] * len(s.points)
        for q, point in enumerate(s.points):
            j = _taxel_of(name, point) if local else None
            key: object = (w, q)
            if j is not None:
                # Points of different taxels share one run of the chain.
                own = (name, j, tuple((k, float(v)) for k, v in point.items() if not v.ndim))
                key = (own[0], own[2], turns[own])
                turns[own] += 1
            runs.setdefault(key, []).append((w, q, j))
    for members in runs.values():
        name = wanted[members[0][0]][0]
        point = {k: v.copy() for k, v in wanted[members[0][0]][1].points[members[0][1]].items()}
        for w, q, j in members[1:]:
            for k, v in point.items():
                if v.ndim:
                    v[j] = wanted[w][1].points[q][k][j]
        effects = {**have, name: _joined(name, have.get(name), point)}
        mean = forward.mean @ ((forward.with_effects(prediction, effects) - prediction.values) * slope)
        for w, q, j in members:
            found[w][q] = Slopes.of(mean[..., None]) if j is None else Slopes.of_taxel(mean[:, j], j, taxels)
    for (name, s), parts in zip(wanted, found, strict=True):
        columns = Slopes.joined(parts)
        if columns.moves:
            yield Candidate(name, s, columns)


def starts_of(name: str, scene: Scene) -> tuple[Start, ...]:
    """Return the starts of an effect, clipped to the bounds of its parameters."""
    own = effect(name)

    def inside(point: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
        return {k: np.clip(v, own.parameter(k).low, own.parameter(k).high) for k, v in point.items()}

    return tuple(replace(s, points=tuple(inside(p) for p in s.points)) for s in own.starts(scene))


def _taxel_of(name: str, point: Mapping[str, FloatArray]) -> int | None:
    """Return the taxel that a point changes, if it changes one alone."""
    own: set[int] = set()
    for k, v in point.items():
        if v.ndim:
            own |= set(np.flatnonzero(v != effect(name).parameter(k).neutral).tolist())
    return own.pop() if len(own) == 1 else None


def _joined(
    name: str, before: Mapping[str, FloatArray] | None, point: Mapping[str, FloatArray]
) -> dict[str, FloatArray]:
    """Merge a point with the present parameters of the same effect, taxel by taxel."""
    if before is None:
        return dict(point)
    out = {k: np.array(v) for k, v in before.items()}
    strengths = [
        p for p in effect(name).parameters if p.role == "strength" and p.name in point and point[p.name].ndim
    ]
    for k, v in point.items():
        if v.ndim and k in out:
            for p in strengths:
                changed = point[p.name] != p.neutral
                out[k][changed] = v[changed]
        else:
            out.setdefault(k, v)
    return out


def parameters_from_step(
    name: str, s: Start, coefficients: FloatArray, before: Mapping[str, FloatArray] | None
) -> dict[str, FloatArray]:
    """Return the parameters, within bounds, that multiples of the points of a start stand for."""
    own = effect(name)
    out: dict[str, FloatArray] = {}
    for p in own.parameters:
        given = [pt[p.name] for pt in s.points if p.name in pt]
        if p.role != "strength" or not given:
            if given:
                out[p.name] = np.array(given[0])
            elif p.role != "strength" and p.shape == "scalar":
                out[p.name] = np.asarray(p.neutral)
            continue
        value = np.full(np.shape(given[0]), p.neutral, dtype=np.float64)
        for c, pt in zip(coefficients, s.points, strict=True):
            if p.name in pt:
                value = value + c * (pt[p.name] - p.neutral)
        out[p.name] = np.clip(value, p.low, p.high)
    return _joined(name, before, out) if before is not None else out
