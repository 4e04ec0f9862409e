"""The effects that were named: their parameters, intervals, and where the residual lies without them."""

from __future__ import annotations

import numpy as np

from skincal.dataset import Dataset
from skincal.diagnose.base_fit import Base
from skincal.diagnose.diagnosis import NamedEffect
from skincal.gap.choice import Choice, Named
from skincal.gap.free import parameters_at
from skincal.gap.models import Model
from skincal.gap.signatures import where_text

_WIDTH = 1.96


def named_effects(choice: Choice, base: Base, dataset: Dataset) -> tuple[NamedEffect, ...]:
    """What was named, with intervals (95 %) of all parameters.

    Args:
        choice: the effects, fitted together.
        base: the base model's fit, with the presses that the choice saw.
        dataset: gives the layout.
    """
    found: list[NamedEffect] = []
    spread = np.sqrt(
        np.maximum(np.diag(choice.after.refit.covariance)[5:], 0.0)
        * max(1.0, _mean_square(choice.after, base))
    )
    x, coords = choice.after.refit.x, choice.after.coords
    low = parameters_at(coords, x - _WIDTH * spread, choice.after.held)
    high = parameters_at(coords, x + _WIDTH * spread, choice.after.held)
    best = choice.after.hypothesis.effects
    for one in choice.named:
        ends = {
            name: (
                np.minimum(low[one.name][name], high[one.name][name]),
                np.maximum(low[one.name][name], high[one.name][name]),
            )
            for name in best[one.name]
        }
        found.append(
            NamedEffect(
                one.name,
                one.consistent_with,
                one.p_value,
                dict(best[one.name]),
                ends,
                where_without(one, choice, base, dataset),
                one.share,
                one.by_places,
            )
        )
    return tuple(found)


def where_left(base: Base, model: Model, dataset: Dataset) -> str:
    """Where the residual lies that a model leaves of the presses that it was fitted to, in a sentence."""
    m = base.material
    return where_text(model.refit.slopes.residual, m.reading.seen, m.session, dataset.layout(), m.known)


def where_without(one: Named, choice: Choice, base: Base, dataset: Dataset) -> str:
    """Where the residual lies that is left without one of the effects that were named."""
    if one.by_places:
        return "in where presses turn out to be: images do not show it"
    if sum(not other.by_places for other in choice.named) == 1:
        return where_left(base, choice.before, dataset)
    m, after = base.material, choice.after.hypothesis
    others = {name: values for name, values in after.effects.items() if name != one.name}
    residual = np.nan_to_num(m.reading.residual(after.with_effects(others).values(m.session)))
    return where_text(residual, m.reading.seen, m.session, dataset.layout(), m.known)


def _mean_square(model: Model, base: Base) -> float:
    """What a model leaves of the presses that it was fitted to, in squares of the noise."""
    seen = base.material.reading.seen & base.material.known[:, None]
    return float((model.refit.slopes.residual[seen] ** 2).mean())
