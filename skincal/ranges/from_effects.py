"""Ranges of the parameters of a calibration's effects.

A parameter is drawn over its interval, evenly on the scale on which it is fitted, and within its bounds. A parameter
without an interval keeps its fitted value. A list, with one number per taxel or hand pose, becomes a list of ranges. An
interval that is open on one side ends at the bound. An interval that is open on both sides says nothing: the fitted
value stays, with a warning.
"""

from __future__ import annotations

import numpy as np

from skincal.calibration import Effect
from skincal.effects import EFFECTS, EffectParameter
from skincal.errors import Problem
from skincal.model.arrays import FloatArray
from skincal.ranges.parameter import Numbers, Parameter


def effect_parameters(effect: Effect, warnings: list[Problem]) -> dict[str, Parameter]:
    """Return the ranges of an effect's parameters by full name."""
    if EFFECTS[effect.name].of_rig:
        place = f"calibration.toml, [effects] {effect.name}"
        fix = "Environments know the true places and forces, and leave it out."
        warnings.append(Problem(place, "an effect of the skin", "an error of what the rig measured", fix))
    known = {p.name: p for p in EFFECTS[effect.name].parameters}
    return {
        f"skin.effects.{effect.name}.{name}": _range(effect, known[name], value, warnings)
        for name, value in effect.parameters.items()
    }


def _range(effect: Effect, parameter: EffectParameter, value: Numbers, warnings: list[Problem]) -> Parameter:
    interval = effect.intervals.get(parameter.name)
    if interval is None:
        return Parameter.constant(value, source="calibrated")
    found = np.asarray(value, dtype=np.float64)
    low, high = (np.asarray(side, dtype=np.float64) for side in interval)
    nothing = np.isneginf(low) & np.isposinf(high)
    if nothing.any():
        which = "" if not nothing.ndim else f" of {int(nothing.sum())} of {nothing.size}"
        fix = f"The data do not determine {parameter.name}{which}; the fitted value stays."
        place = f"calibration.toml, [effects] {effect.name}, intervals.{parameter.name}"
        warnings.append(Problem(place, "a bounded interval", "[-inf, inf]", fix))
    low = np.where(nothing, found, np.clip(low, parameter.low, parameter.high))
    high = np.where(nothing, found, np.clip(high, parameter.low, parameter.high))
    if (low == found).all() and (high == found).all():
        return Parameter.constant(value, source="calibrated")
    kind = Parameter.log_uniform if parameter.scale == "log" else Parameter.uniform
    return kind(_numbers(low), _numbers(high), source="calibrated")


def _numbers(array: FloatArray) -> Numbers:
    return tuple(float(v) for v in array) if array.ndim else float(array)
