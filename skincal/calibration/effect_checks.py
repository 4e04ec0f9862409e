"""Checks of an entry of ``[[effects]]``: its parameters exist, have the right shape and lie within bounds."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from skincal.calibration.parts import Effect
from skincal.dataset.findings import did_you_mean
from skincal.dataset.schema_errors import Violation, within
from skincal.effects import EFFECTS


def effects_violations(effects: Sequence[Effect], taxels: int) -> Iterator[Violation]:
    """Yield what is wrong with the parameters of effects; ``taxels`` is J, 0 if unknown."""
    for i, effect in enumerate(effects):
        if effect.name in EFFECTS:
            yield from within(("effects", i), _effect(effect, taxels))
        if effect.name and effect.name in [earlier.name for earlier in effects[:i]]:
            fix = "Put its parameters into one table."
            yield ("effects", i, "name"), "each effect once", f"{effect.name} twice", fix


def _effect(effect: Effect, taxels: int) -> Iterator[Violation]:
    known = {parameter.name: parameter for parameter in EFFECTS[effect.name].parameters}
    for name, value in effect.parameters.items():
        key, parameter = f"parameters.{name}", known.get(name)
        if parameter is None:
            yield key, f"one of {', '.join(known)}", name, _meant(name, known)
        elif (
            fault := parameter.fault(np.nan_to_num(value, nan=parameter.neutral), taxels, len(effect.poses))
        ) is not None:
            yield key, *fault
    for name, (low, high) in effect.intervals.items():
        like = effect.parameters.get(name)
        if like is None:
            expected = f"one of the parameters: {', '.join(effect.parameters) or 'none'}"
            yield f"intervals.{name}", expected, "an unknown name"
        elif not np.shape(low) == np.shape(high) == np.shape(like) or np.any(np.array(low) > np.array(high)):
            size = f", each a list of {len(like)} numbers" if isinstance(like, tuple) else ""
            yield f"intervals.{name}", f"[low, high], in ascending order{size}", (low, high)
    if effect.poses and not any(p.shape == "per-pose" for p in known.values()):
        yield "poses", f"nothing: {effect.name} does not depend on the hand pose", effect.poses


def _meant(name: str, known: Iterable[str]) -> str:
    close = did_you_mean(name, known)
    return f'Did you mean "{close}"?' if close else ""
