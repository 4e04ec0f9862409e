"""Registry of all effects, one line each, in the order in which effects of one stage act; effects with parameters.

Effects of other packages come through the entry point group ``skincal.effects``, after those that are here.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Final, Literal, TypeVar, cast

from numpy.typing import ArrayLike

from skincal.covariates import COVARIATES
from skincal.effects.effect import Effect, Stage
from skincal.effects.parameter import Values
from skincal.effects.samples import Samples
from skincal.errors import input_error, quoted, shown

_OWN: Final = (
    "force_bias:ForceBias",
    "contact_offset:ContactOffset",
    "indenter_radius:IndenterRadius",
    "cover:Cover",
    "shear:Shear",
    "stiffening:Stiffening",
    "spread:Spread",
    "rate:Rate",
    "hysteresis:Hysteresis",
    "creep:Creep",
    "latency:Latency",
    "first_cycle:FirstCycle",
    "response_curve:ResponseCurve",
    "taxel_gain:TaxelGain",
    "gain_drift:GainDrift",
    "crosstalk:Crosstalk",
    "ghosting:Ghosting",
    "dead_band:DeadBand",
    "saturation:Saturation",
    "taxel_offset:TaxelOffset",
    "baseline_drift:BaselineDrift",
    "dead_taxel:DeadTaxel",
)
"""Module and class of each effect of skincal, as an entry point names them."""

GROUP: Final = "skincal.effects"
"""Entry points of this group are effects of other packages: a subclass of :class:`Effect`, or an instance of one."""


class Registry(Mapping[str, Effect]):
    """Every effect by its name, in the order of the chain.

    Effects are loaded when the registry is first looked into, not when it is imported: the modules of other packages
    import :mod:`skincal.effects` themselves.
    """

    def __getitem__(self, name: str) -> Effect:
        return self._effects[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._effects)

    def __len__(self) -> int:
        return len(self._effects)

    @cached_property
    def _effects(self) -> dict[str, Effect]:
        own = [EntryPoint(value, f"skincal.effects.{value}", GROUP) for value in _OWN]
        found: dict[str, Effect] = {}
        for point in (*own, *entry_points(group=GROUP)):
            one = _load(point)
            if one.name in found:
                got = f'a second effect named "{one.name}"'
                raise input_error(_place(point), "a name of its own", got, "Rename the effect.")
            found[one.name] = one
        return {one.name: one for one in sorted(found.values(), key=lambda e: e.stage)}


def _place(point: EntryPoint) -> str:
    package = "" if point.dist is None else f" of package {point.dist.name}"
    return f"entry point {point.name} in {GROUP}{package}"


def _load(point: EntryPoint) -> Effect:
    """Return the effect that an entry point names.

    Raises:
        InputError: it cannot be loaded, or is no effect.
    """
    mend = f"Mend {point.value}, or uninstall the package."
    try:
        loaded: object = point.load()
        one = loaded() if isinstance(loaded, type) else loaded
        known: Any = one
        found = isinstance(one, Effect) and isinstance(known.name, str) and isinstance(known.stage, Stage)
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # a package may raise SystemExit, too
        raise input_error(_place(point), "an effect that can be loaded", quoted(error), mend) from error
    if not found:
        expected = "a subclass of skincal.effects.Effect with its name and stage"
        raise input_error(_place(point), expected, shown(loaded), mend)
    return cast(Effect, one)


EFFECTS: Final[Mapping[str, Effect]] = Registry()
"""Every effect by its name, in the order of the chain."""


def effect(name: str) -> Effect:
    """Return an effect by its name.

    Raises:
        InputError: there is no such effect.
    """
    found = EFFECTS.get(name)
    if found is not None:
        return found
    close = difflib.get_close_matches(name, EFFECTS, n=1)
    fix = f"Did you mean {close[0]}?" if close else ""
    raise input_error("effect", f"one of {', '.join(sorted(EFFECTS))}", f'"{name}"', fix)


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
