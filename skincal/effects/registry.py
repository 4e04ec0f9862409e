"""Registry of all effects, one line each, in the order in which effects of one stage act.

Effects of other packages come through the entry point group ``skincal.effects``, after those that are here.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping
from importlib.metadata import EntryPoint, entry_points
from typing import Final

from skincal.effects.baseline_drift import BaselineDrift
from skincal.effects.contact_offset import ContactOffset
from skincal.effects.cover import Cover
from skincal.effects.creep import Creep
from skincal.effects.crosstalk import Crosstalk
from skincal.effects.dead_band import DeadBand
from skincal.effects.dead_taxel import DeadTaxel
from skincal.effects.effect import Effect
from skincal.effects.first_cycle import FirstCycle
from skincal.effects.force_bias import ForceBias
from skincal.effects.gain_drift import GainDrift
from skincal.effects.ghosting import Ghosting
from skincal.effects.hysteresis import Hysteresis
from skincal.effects.indenter_radius import IndenterRadius
from skincal.effects.latency import Latency
from skincal.effects.rate import Rate
from skincal.effects.response_curve import ResponseCurve
from skincal.effects.saturation import Saturation
from skincal.effects.shear import Shear
from skincal.effects.spread import Spread
from skincal.effects.stiffening import Stiffening
from skincal.effects.taxel_gain import TaxelGain
from skincal.effects.taxel_offset import TaxelOffset
from skincal.errors import InputError, Problem

_ALL: Final[tuple[Effect, ...]] = (
    ForceBias(),
    ContactOffset(),
    IndenterRadius(),
    Cover(),
    Shear(),
    Stiffening(),
    Spread(),
    Rate(),
    Hysteresis(),
    Creep(),
    Latency(),
    FirstCycle(),
    ResponseCurve(),
    TaxelGain(),
    GainDrift(),
    Crosstalk(),
    Ghosting(),
    DeadBand(),
    Saturation(),
    TaxelOffset(),
    BaselineDrift(),
    DeadTaxel(),
)

GROUP: Final = "skincal.effects"
"""Entry points of this group are effects of other packages: a subclass of :class:`Effect`, or an instance of one."""


class Registry(Mapping[str, Effect]):
    """Every effect by its name, in the order of the chain.

    Entry points are loaded when the registry is first looked into, not when it is imported: their modules import
    :mod:`skincal.effects` themselves.
    """

    def __init__(self, own: tuple[Effect, ...] = _ALL) -> None:
        """Take the effects that come with skincal."""
        self._own = own
        self._effects: dict[str, Effect] | None = None

    def __getitem__(self, name: str) -> Effect:
        return self._loaded()[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._loaded())

    def __len__(self) -> int:
        return len(self._loaded())

    def _loaded(self) -> dict[str, Effect]:
        if self._effects is None:
            found = {one.name: one for one in self._own}
            for point in entry_points(group=GROUP):
                one = _of_package(point)
                if one.name in found:
                    got = f'a second effect named "{one.name}"'
                    raise InputError([Problem(_place(point), "a name of its own", got, "Rename the effect.")])
                found[one.name] = one
            self._effects = {one.name: one for one in sorted(found.values(), key=lambda e: e.stage)}
        return self._effects


def _place(point: EntryPoint) -> str:
    package = "" if point.dist is None else f" of package {point.dist.name}"
    return f"entry point {point.name} in {GROUP}{package}"


def _of_package(point: EntryPoint) -> Effect:
    """The effect that an entry point names.

    Raises:
        InputError: it cannot be loaded, or is no effect.
    """
    mend = f"Mend {point.value}, or uninstall the package."
    try:
        loaded: object = point.load()
        one = loaded() if isinstance(loaded, type) else loaded
    except Exception as error:
        got = f"{type(error).__name__}: {error}"
        raise InputError([Problem(_place(point), "an effect that can be loaded", got, mend)]) from error
    if not isinstance(one, Effect):
        raise InputError([Problem(_place(point), "a subclass of skincal.effects.Effect", repr(loaded), mend)])
    return one


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
    raise InputError([Problem("effect", f"one of {', '.join(sorted(EFFECTS))}", f'"{name}"', fix)])
