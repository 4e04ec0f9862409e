"""Checks of an entry of ``[[effects]]``: its parameters exist, have the right shape and lie within bounds."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence

import numpy as np

from skincal.calibration.effects import EFFECT_NAMES
from skincal.calibration.parts import Effect, Numbers
from skincal.calibration.values import shown
from skincal.dataset.toml_table import TomlTable
from skincal.effects import EFFECTS, EffectParameter


def check_name(table: TomlTable, name: str, earlier: Sequence[str]) -> bool:
    """Return whether an effect has a known name, and is the only one with it; else add an error.

    Args:
        table: the entry.
        name: name of the effect; empty if it is missing.
        earlier: names of the preceding entries.
    """
    if not name:
        return False
    if name not in EFFECT_NAMES:
        table.error("name", f"one of {', '.join(EFFECT_NAMES)}", f'"{name}"', _meant(name, EFFECT_NAMES))
        return False
    if name in earlier:
        table.error("name", "each effect once", f'"{name}" twice', "Put its parameters into one table.")
    return True


def check_effect(table: TomlTable, effect: Effect, taxels: int) -> None:
    """Add an error for every invalid parameter of an effect.

    Args:
        table: the entry.
        effect: the effect, with a known name.
        taxels: number of taxels J; 0 if unknown.
    """
    known = {parameter.name: parameter for parameter in EFFECTS[effect.name].parameters}
    for name, value in effect.parameters.items():
        place = f"parameters.{name}"
        parameter = known.get(name)
        if parameter is None:
            table.error(place, f"one of {', '.join(known)}", f'"{name}"', _meant(name, known))
        elif (expected := _wrong_shape(parameter, value, taxels, len(effect.poses))) is not None:
            table.error(place, expected, shown(value))
        elif (bad := _outside(parameter, value)) is not None:
            table.error(place, f"{parameter.low:g} to {parameter.high:g} {parameter.unit}", f"{bad:g}")
    if effect.poses and not any(p.shape == "per-pose" for p in known.values()):
        table.error("poses", f"nothing: {effect.name} does not depend on the hand pose", shown(effect.poses))


def _wrong_shape(parameter: EffectParameter, value: Numbers, taxels: int, poses: int) -> str | None:
    """Return the expected shape of a value; None if its shape is valid."""
    if not isinstance(value, tuple):
        return None
    if parameter.shape == "scalar":
        return "one number"
    if parameter.shape == "per-taxel":
        wrong = taxels and len(value) != taxels
        return f"one number, or {taxels}, one for each taxel" if wrong else None
    wrong = poses and len(value) not in (1, poses)
    return f"one number, or {poses}, one for each of the poses" if wrong else None


def _outside(parameter: EffectParameter, value: Numbers) -> float | None:
    numbers = np.atleast_1d(value)
    outside = numbers[(numbers < parameter.low) | (numbers > parameter.high)]
    return float(outside[0]) if len(outside) else None


def _meant(name: str, known: Iterable[str]) -> str:
    close = difflib.get_close_matches(name, list(known), n=1)
    return f'Did you mean "{close[0]}"?' if close else ""
