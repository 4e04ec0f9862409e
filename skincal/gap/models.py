"""A session's material and the models that are fitted to it: the base model, and the base model with effects.

A model is fitted to all that choice and fit may see. What it leaves is counted with sensor, places and the contact
law's own error projected out, so that models are compared by what effects do.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np

from skincal.gap.candidates import Found, Scene
from skincal.gap.free import Coordinate
from skincal.gap.hypothesis import Hypothesis, Parameters
from skincal.gap.noise import NORMAL
from skincal.gap.problem import RefitOptions
from skincal.gap.reading import Reading
from skincal.gap.refit import Refit, refit
from skincal.gap.relocate import relocated
from skincal.inference.session import GapSession
from skincal.model.arrays import BoolArray, FloatArray

_SHARES = (1.0, 0.3)
_SETTLE = 3
"""Steps in which only presses move, from a new beginning."""
_LOOKS = 2
"""Presses are looked for so many times at most."""
_MANY, _ROUNDS = 60, 3
"""Steps, and looks for presses, of the fit that counts."""
_ABOUT_ONE = 0.02
"""Gains whose middle is so near to one are left as they are."""
_NARROWEST, _A_CROWD = 1.0, 6
"""The narrowest prior of numbers of single taxels [typical values], and of how many it is told at least."""
_MUCH = 20.0
"""No further look where the last one lowered the objective by less."""


@dataclass(frozen=True, eq=False)
class Material:
    """What is to be explained, and how it is split.

    Attributes:
        session: what was pressed.
        reading: what was read.
        learn: (N,) observations that parameters are found on.
        score: (N,) observations that choose.
        options: priors of a refit.
        law: (N, J, m) whitened directions in which the contact law may err; None: it does not.
    """

    session: GapSession
    reading: Reading
    learn: BoolArray
    score: BoolArray
    options: RefitOptions
    law: FloatArray | None = None

    @property
    def known(self) -> BoolArray:
        """(N,) what choice and fit see."""
        return self.learn | self.score

    @property
    def alone(self) -> Self:
        """The same for a piece of work that one process does by itself."""
        return replace(self, options=self.options.alone)


@dataclass(frozen=True, eq=False)
class Model:
    """A refit with its effects.

    Attributes:
        refit: sensor, places and effects.
        coords: their numbers.
        held: parameters that were held.
    """

    refit: Refit
    coords: tuple[Coordinate, ...] = ()
    held: Mapping[str, Parameters] = field(default_factory=dict[str, Parameters])

    @property
    def hypothesis(self) -> Hypothesis:
        """What it takes to be true."""
        return self.refit.hypothesis

    @property
    def names(self) -> tuple[str, ...]:
        """Its effects."""
        return tuple(self.refit.hypothesis.effects)


def excess_of(model: Model, material: Material, null_mean: float) -> float:
    """What a model leaves beyond what a null session does, over all that choice and fit see.

    It is the objective of the fit, squared residuals and what presses had to move against the prior of their places,
    less what the contact law's own error explains of it. With the places integrated out, its mean is the number of
    values that were read.

    Args:
        model: a fit.
        material: the session.
        null_mean: mean square of a null session's residual.
    """
    seen = material.reading.seen & material.known[:, None]
    left = scene_of(model, material).part(material.known).residual
    return float((left**2).sum()) - null_mean * float(seen.sum())


def scene_of(model: Model, material: Material) -> Scene:
    """A model's fit as candidates are tried on it."""
    m, found = material, model.refit
    return Scene.of(found.hypothesis, found.slopes, m.session, m.reading, m.options, m.law)


def extended(model: Model, found: Found, material: Material) -> Model:
    """A model with one more effect, all of it fitted again.

    The search saw sensor and places to first order only. Where the fit from its end comes out worse than without the
    effect, it is started again nearer to neutral.
    """
    coords = (*model.coords, *found.start.coords)
    held = {**model.held, **found.start.held}
    tried: list[Model] = []
    for share in _SHARES:
        x = np.concatenate([model.refit.x, share * found.x])
        tried.append(fitted(model.hypothesis, coords, x, held, material))
        if tried[-1].refit.objective < model.refit.objective:
            break
    return min(tried, key=lambda m: m.refit.objective)


def fitted(
    start: Hypothesis,
    coords: tuple[Coordinate, ...],
    x: FloatArray,
    held: Mapping[str, Parameters],
    material: Material,
    settle: int = 0,
) -> Model:
    """A model from a start, learned from all that choice and fit may see.

    Args:
        start: sensor and places.
        coords: numbers of effects.
        x: (n,) where they start.
        held: parameters that are held.
        material: the session.
        settle: steps in which only presses move.
    """
    options = replace(material.options, settle=settle, steps=material.options.steps + settle)
    found = refit(start, material.session, material.reading, options, coords, x, material.known, held)
    return Model(found, coords, held)


def found_again(model: Model, material: Material) -> Model:
    """A model with presses found again that it left in the wrong valley; itself where it fits no worse.

    What an effect does is taken for places, forces and a sensor that are not the true ones as long as the effect is not
    in the model, and going downhill from there does not always lead back.
    """
    for _ in range(_LOOKS):
        start = model.hypothesis
        placed = relocated(start, material.session, material.reading, material.options)
        if placed is start:
            break
        other = fitted(placed, model.coords, model.refit.x, model.held, material)
        fall = model.refit.objective - other.refit.objective
        model = other if fall > 0 else model
        if fall < _MUCH:
            break
    return model


def begun_again(model: Model, material: Material, fresh: Hypothesis) -> Model:
    """A model fitted from another sensor and other places, its effects starting where they are; it may fit worse."""
    return fitted(fresh, model.coords, model.refit.x, model.held, material, settle=_SETTLE)


def better(one: Model, other: Model) -> Model:
    """That which fits better; the first where both fit alike."""
    return min(one, other, key=lambda m: m.refit.objective)


def finished(model: Model, material: Material) -> Model:
    """A model gone on with for as long as it gains; itself where it has ended.

    A fit among many takes few steps. The one that counts takes as many as it needs.
    """
    long = replace(material, options=replace(material.options, steps=_MANY))
    for _ in range(_ROUNDS):
        other = found_again(fitted(model.hypothesis, model.coords, model.refit.x, model.held, long), long)
        fall = model.refit.objective - other.refit.objective
        model = other if fall > 0 else model
        if fall < _MUCH:
            break
    return model


def levelled(model: Model, material: Material) -> Model:
    """A model with gains of taxels about one; itself where they are, or where it has none.

    What all gains share is the scale S of the counts. A fit may run far along that, S a multiple and all gains a
    fraction of what they should be, and is slow on the way back. It begins again from where both mean the same.
    """
    own = [k for k, c in enumerate(model.coords) if (c.effect, c.parameter.name) == ("taxel_gain", "gain")]
    if not own:
        return model
    gains = np.array([model.coords[k].value(float(model.refit.x[k])) for k in own])
    shared = float(np.median(gains))
    if abs(shared - 1) < _ABOUT_ONE:
        return model
    x = model.refit.x.copy()
    x[own] = [model.coords[k].at(gain / shared) for k, gain in zip(own, gains.tolist(), strict=True)]
    start = model.hypothesis.moved(np.array([0.0, 0.0, 0.0, 0.0, np.log(shared)]))
    other = fitted(start, model.coords, x, model.held, material)
    return min(model, other, key=lambda m: m.refit.objective)


def pooled(model: Model, material: Material) -> Model:
    """A model whose numbers of single taxels have a prior as wide as they scatter; itself where it is the broad one.

    What a press or two say of the gain of a taxel that hardly any other has lit can be far off, and other presses there
    come out worse than without the effect. Taxels of one skin differ as its others do (an empirical prior: Efron,
    Morris, J. Am. Stat. Assoc. 70 (1975) 311). The scatter is the median one, which a few odd taxels do not widen.
    """
    own: dict[tuple[str, str], list[int]] = {}
    for k, c in enumerate(model.coords):
        if c.is_strength and c.parameter.shape == "per-taxel":
            own.setdefault((c.effect, c.parameter.name), []).append(k)
    coords = list(model.coords)
    for rows in own.values():
        x = model.refit.x[rows]
        scatter = max(NORMAL * float(np.median(np.abs(x - np.median(x)))), _NARROWEST)
        if len(rows) >= _A_CROWD and scatter < coords[rows[0]].prior:
            for k in rows:
                coords[k] = replace(coords[k], scatter=scatter)
    if coords == list(model.coords):
        return model
    return fitted(model.hypothesis, tuple(coords), model.refit.x, model.held, material)


def without(model: Model, name: str, material: Material) -> Model:
    """A model with one effect dropped and the rest fitted again."""
    keep = np.array([c.effect != name for c in model.coords], dtype=np.bool_)
    coords = tuple(c for c in model.coords if c.effect != name)
    held = {key: value for key, value in model.held.items() if key != name}
    return fitted(model.hypothesis, coords, model.refit.x[keep], held, material)
