"""An effect against what came near it when it was named, beside all that was named later.

In the round in which an effect is named nothing of what comes after it is in the model. What is still missing then
can favour the wrong one of two effects that are alike.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from skincal.gap.candidates import Found, Start
from skincal.gap.choice_options import ChoiceOptions
from skincal.gap.models import Material, Model, excess_of, extended, without


def rivals(falls: Mapping[str, float], name: str, model: Model, options: ChoiceOptions) -> list[str]:
    """Names of effects that explained a fair part of what the one did that was named, and are not in the model.

    Args:
        falls: what each explained in its round.
        name: of the effect that was named.
        model: with all that was named.
        options: say what is a fair part.
    """
    return [n for n in falls if n not in model.names and falls[n] >= options.half * falls[name]]


def beside_all(
    model: Model,
    name: str,
    fits: Mapping[str, Model],
    material: Material,
    options: ChoiceOptions,
    values: int,
) -> tuple[Model, tuple[str, ...]]:
    """The model with the effect or, where that explains clearly less, with the rival that explains most in its place.

    And the names that cannot be told apart beside all the others, that of the effect which is in the model first.

    Args:
        model: with all that was named.
        name: of one of its effects.
        fits: full fits of its rivals, from which they begin.
        material: the session.
        options: say what cannot be told apart.
        values: that were read.
    """
    base = without(model, name, material)
    tried = {name: model, **{n: extended(base, _as_found(n, fit), material) for n, fit in fits.items()}}
    left = excess_of(base, material, 0.0)
    falls = {n: left - excess_of(m, material, 0.0) for n, m in tried.items()}
    best = max(falls, key=falls.__getitem__)
    alike = sorted(
        (n for n in falls if falls[n] >= options.about(falls[best], values)), key=lambda n: -falls[n]
    )
    first = name if name in alike else best
    return tried[first], (first, *(n for n in alike if n != first))


def _as_found(name: str, fit: Model) -> Found:
    """An effect as a full fit left it."""
    own = [i for i, c in enumerate(fit.coords) if c.effect == name]
    held = {name: fit.held[name]} if name in fit.held else {}
    start = Start(name, tuple(fit.coords[i] for i in own), held)
    return Found(start, fit.refit.x[np.array(own, dtype=np.int64)], 0.0, 0.0)
