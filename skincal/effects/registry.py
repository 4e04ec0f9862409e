"""Registry of all effects, one line each, in the order in which effects of one stage act."""

from __future__ import annotations

import difflib
from types import MappingProxyType
from typing import Final

from skincal.effects.base import Effect
from skincal.effects.baseline_drift import BaselineDrift
from skincal.effects.contact_offset import ContactOffset
from skincal.effects.cover import Cover
from skincal.effects.creep import Creep
from skincal.effects.crosstalk import Crosstalk
from skincal.effects.dead_band import DeadBand
from skincal.effects.dead_taxel import DeadTaxel
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

EFFECTS: Final = MappingProxyType({effect.name: effect for effect in sorted(_ALL, key=lambda e: e.stage)})
"""All effects by name, in the order of the chain."""


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
