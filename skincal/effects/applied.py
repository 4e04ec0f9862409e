"""Effects with their parameters, in the order of the chain."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, TypeVar

from numpy.typing import ArrayLike

from skincal.covariates import COVARIATES
from skincal.effects.effect import Effect
from skincal.effects.parameter import Values
from skincal.effects.registry import EFFECTS, effect
from skincal.effects.samples import Samples
from skincal.errors import input_error

Missing = Literal["error", "abstain"]
"""Policy for samples that lack a covariate which an effect needs."""

Kind = TypeVar("Kind", bound=Effect)


@dataclass(frozen=True, eq=False)
class Applied:
    """An effect with its parameters."""

    effect: Effect
    values: Values

    @cached_property
    def neutral(self) -> bool:
        """True if the effect has no influence at these values."""
        return self.effect.is_neutral(self.values)

    @cached_property
    def needs(self) -> tuple[str, ...]:
        """Covariates that the effect needs at these values."""
        return self.effect.needs(self.values)

    @property
    def key(self) -> tuple[object, ...]:
        """Hashable key, equal for the same effect at equal values."""
        return (self.effect.name, self.values.key)


def applied(effects: Mapping[str, Mapping[str, ArrayLike]], taxels: int) -> tuple[Applied, ...]:
    """Return effects by name with their parameters, checked and in the order of the chain.

    Raises:
        InputError: unknown effects or parameters, or values out of bounds.
    """
    order = list(EFFECTS)
    some = [Applied(effect(name), effect(name).checked(given, taxels)) for name, given in effects.items()]
    return tuple(sorted(some, key=lambda a: order.index(a.effect.name)))


def at_work(
    all_of_them: tuple[Applied, ...], samples: Samples, kind: type[Kind], missing: Missing
) -> list[tuple[int, Kind, Values]]:
    """Return the effects of a kind that are not neutral and have their covariates: index, effect and values.

    Raises:
        InputError: an effect lacks a covariate, and ``missing`` makes that an error.
    """
    found: list[tuple[int, Kind, Values]] = []
    for number, one in enumerate(all_of_them):
        if not isinstance(one.effect, kind) or one.neutral:
            continue
        lacking = [name for name in one.needs if not samples.has(name)]
        if not lacking:
            found.append((number, one.effect, one.values))
        elif missing == "error":
            columns = ", ".join(COVARIATES[name].attribute for name in lacking)
            place = f"effect {one.effect.name}"
            fix = "Give them, or let effects without their covariates abstain."
            raise input_error(place, f"samples with {columns}", "samples without", fix)
    return found
