"""Registry of all effects, one line each, in the order in which effects of one stage act.

Effects of other packages come through the entry point group ``skincal.effects``, after those that are here.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping
from functools import cached_property
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Final, cast

from skincal.effects.effect import Effect, Stage
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
