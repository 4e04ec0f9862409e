"""Ranges from a calibration: calibrated parameters replace the preset's figures; the rest stays as published.

A calibration replaces these figures of the preset:

- The centre of the patch (``y_m`` with ``beta_deg``, or ``x_m`` on a plane), ``alpha_deg``, E and S: each
  becomes uniform over its interval. An offset of the preset (``y_offset_m``, ``x_offset_m``) states the
  uncertainty of the patch's place; a calibrated centre replaces it.
- ``scale_per_taxel_per_n`` becomes a constant ``scale_offset_per_n``: S_j - S, so that S varies as a whole.
- The numbers of a contact law, where there is one, stand under ``skin.contact_law``.
- Parameters of effects stand under ``skin.effects.NAME``. One that says so (``replaces_range``) replaces the preset's
  spread of the taxels.

Where the data leave a parameter unbounded, the preset's range stays, marked as assumed. S is an exception: it belongs
to one sensor and its converter, so that a calibration without an interval for S is refused unless a range is assumed.
Where the preset has no range, or one that the sensor's mount excludes (the preset's figures are those of the published
fingertip), the range of the mount is used.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from math import isfinite
from typing import Final

import numpy as np

from skincal.calibration import Calibration, Effect
from skincal.calibration.parts import LAW, REST
from skincal.effects import EFFECTS, EffectParameter
from skincal.errors import Problem, WorkError, input_error
from skincal.model.arrays import FloatArray
from skincal.ranges import presets
from skincal.ranges.parameter import Numbers, Parameter
from skincal.ranges.ranges import JointDraws, Ranges

DRAWS: Final = 500
"""Default number of draws of the joint cloud."""

_OFFSETS: Final = {"y_m": "y_offset_m", "x_m": "x_offset_m", "beta_deg": "x_offset_m"}
"""The preset's offset that states the uncertainty of each parameter."""

_SCALE: Final = "scale_per_n"
_CONSTANT: Final = partial(Parameter.constant, source="calibrated")
_UNIFORM: Final = partial(Parameter.uniform, source="calibrated")


def from_calibration(
    calibration: Calibration,
    preset: presets.PresetName | str = "iros24",
    *,
    joint: bool = False,
    draws: int = DRAWS,
    assumed_scale: tuple[float, float] | None = None,
) -> Ranges:
    """Return the ranges of a calibration, and of a preset for what the calibration does not know.

    Args:
        calibration: the calibration.
        preset: ``iros24`` or ``icra26``.
        joint: whether to include the joint posterior draws, so that their columns are drawn together.
        draws: largest number of joint draws, taken evenly from the rows.
        assumed_scale: low and high of S [1/N] to assume where the calibration leaves it open.

    Returns:
        The ranges; their ``warnings`` name what the calibration leaves open, and what replaces it.

    Raises:
        InputError: there is no such preset; ``joint`` is set and the calibration has no draws; or the assumed
            scale is not a range.
        WorkError: the calibration leaves S open, and no range is assumed. S belongs to one sensor and converter: the
            preset's is that of another.
    """
    parameters = dict(presets.preset(preset))
    warnings: list[Problem] = []
    # On a plane the patch has no angle round the finger; on other surfaces it has no place across.
    flat = calibration.surface.is_plane
    # A pad's y does not lie along a finger either, unlike the preset's.
    for path in ("skin.beta_deg", "skin.y_m", "skin.alpha_deg") if flat else ("skin.x_m",):
        parameters.pop(path, None)
    for name in calibration.intervals:
        if name == REST:
            continue  # the level at rest belongs to the session; a task has its own offsets
        if name == _SCALE and not calibration.identified(name):
            parameters[f"skin.{name}"] = Parameter.uniform(*_assumed_scale(calibration, assumed_scale))
            continue
        _replace(parameters, calibration, name, warnings)
    parameters |= _scale_offsets(calibration)
    for effect in calibration.effects:
        parameters |= effect_parameters(effect, warnings)
        known = EFFECTS[effect.name]
        path = known.replaces_range
        replaces = path in parameters and parameters[path].source == "assumed"
        if replaces and not known.is_neutral(known.checked(effect.parameters, calibration.sensor.taxels)):
            parameters[path] = _CONSTANT(0.0)
    parameters |= _contact_law(calibration)
    cloud = joint_draws(calibration, draws) if joint else None
    for column in cloud.columns if cloud else ():
        parameters.pop(_offset_path(column), None)
    return Ranges(parameters, cloud, _provenance(calibration, preset), warnings)


def _assumed_scale(calibration: Calibration, assumed: tuple[float, float] | None) -> tuple[float, float]:
    if assumed is None:
        low, high = calibration.intervals[_SCALE]
        unit = calibration.sensor.unit_label
        raise WorkError(
            f"{calibration.folder or 'the calibration'}: the data leave the scale S open (its interval is [{low:g}, "
            f"{high:g}]), and that of a preset belongs to another sensor and converter. Collect more presses and fit "
            f"again, or state a range to assume: --assume-scale LOW HIGH [{unit} per N]"
        )
    low, high = assumed
    if not (0 < low < high and isfinite(high)):
        raise input_error("--assume-scale", "0 < LOW < HIGH [counts per N]", f"{low:g} {high:g}")
    return low, high


def joint_draws(calibration: Calibration, draws: int = DRAWS) -> JointDraws:
    """Return the joint posterior draws.

    Raises:
        InputError: the calibration has no draws, or only unbounded parameters, or ``draws`` is below 1.
    """
    if draws < 1:
        raise input_error("draws", "a number above 0", draws)
    if not any(calibration.identified(name) for name in calibration.intervals):
        place = f"{calibration.folder or 'the calibration'}/calibration.toml, [intervals]"
        fix = "Its draws determine nothing. Collect more presses; without the draws the preset's ranges are exported."
        raise input_error(place, "a parameter that the data determine", "none", fix)
    if not calibration.draws:
        place = f"{calibration.folder or 'the calibration'}, draws.parquet"
        fix = "Run skincal fit again, or export the box of intervals."
        raise input_error(place, "draws from the valley", "no such file", fix)
    rows = np.column_stack(list(calibration.draws.values()))
    kept = np.unique(np.linspace(0, len(rows) - 1, min(draws, len(rows))).round().astype(int))
    return JointDraws([f"skin.{name}" for name in calibration.draws], rows[kept])


def _replace(
    parameters: dict[str, Parameter], calibration: Calibration, name: str, warnings: list[Problem]
) -> None:
    low, high = calibration.intervals[name]
    path = f"skin.{name}"
    if calibration.identified(name):
        parameters[path] = _UNIFORM(low, high)
        parameters.pop(_offset_path(path), None)
        return
    parameter, stand_in = _stand_in(parameters, calibration, name)
    parameters[path] = parameter
    place, got = f"calibration.toml, [intervals] {name}", f"[{low:g}, {high:g}]"
    fix = f"The data do not determine {name}; {stand_in} is used instead, as assumed."
    warnings.append(Problem(place, "a bounded interval", got, fix))


def _stand_in(
    parameters: Mapping[str, Parameter], calibration: Calibration, name: str
) -> tuple[Parameter, str]:
    """Return the assumption for a parameter that the data leave open, and its name in messages."""
    published = parameters.get(f"skin.{name}")
    allowed, nominal = _mount(calibration, name)
    if published is not None and not _ruled_out(published, allowed):
        return published, "the preset's range"
    if _offset_path(f"skin.{name}") in parameters:
        offset = _OFFSETS[name]
        return Parameter.constant(nominal), f"the nominal {nominal:g} with the preset's {offset} about it"
    if allowed is not None:
        return Parameter.uniform(*allowed), f"the range of the mount, {allowed[0]:g} to {allowed[1]:g},"
    return Parameter.constant(nominal), f"the best value {nominal:g}"


def _offset_path(path: str) -> str:
    """Return the full name of the offset that states a parameter's uncertainty; '' where there is none."""
    offset = _OFFSETS.get(path.removeprefix("skin."))
    return f"skin.{offset}" if offset else ""


def _mount(calibration: Calibration, name: str) -> tuple[tuple[float, float] | None, float]:
    """Return the range that ``[mount]`` allows (or None), and the nominal value, else the best one."""
    mount, best = calibration.mount, calibration.model.best()[name]
    if mount is None:
        return None, best
    known = {
        "y_m": (mount.y_range_m, mount.y_m),
        "x_m": (mount.x_range_m, mount.x_m),
        "beta_deg": (mount.beta_range_deg, mount.beta_deg),
        "alpha_deg": (mount.alpha_range_deg, mount.alpha_deg),
    }
    allowed, nominal = known.get(name, (None, None))
    return allowed, best if nominal is None else nominal


def _ruled_out(published: Parameter, allowed: tuple[float, float] | None) -> bool:
    """Return whether the mount excludes all of a published range, which is then that of another fingertip."""
    low, high = published.low, published.high
    if allowed is None or not isinstance(low, float) or not isinstance(high, float):
        return False
    return high < allowed[0] or low > allowed[1]


def _scale_offsets(calibration: Calibration) -> dict[str, Parameter]:
    scales, common = calibration.model.scale_per_taxel_per_n, calibration.model.scale_per_n
    if scales is None:
        return {}
    # Keep a taxel that does not respond at zero for every S that is drawn.
    most = 2 * max(common, *(end for end in calibration.intervals[_SCALE] if isfinite(end)))
    if calibration.draws is not None:
        most = max(most, float(calibration.draws[_SCALE].max()))
    return {"skin.scale_offset_per_n": _CONSTANT(tuple(s - common if s > 0 else -most for s in scales))}


def _contact_law(calibration: Calibration) -> dict[str, Parameter]:
    fitted = calibration.contact_law
    if fitted is None:
        return {}
    found: dict[str, Parameter] = {}
    for name in LAW:
        value = float(getattr(fitted.law, name))
        low, high = fitted.intervals.get(name, (value, value))
        known = isfinite(low) and isfinite(high) and low < high
        found[f"skin.contact_law.{name}"] = _UNIFORM(low, high) if known else _CONSTANT(value)
    if size := fitted.law.reference_radius_m:
        found["skin.contact_law.reference_radius_m"] = _CONSTANT(size)
    return found


def _provenance(calibration: Calibration, preset: str) -> dict[str, str]:
    source = calibration.provenance
    values = {
        "preset": preset,
        "calibration": calibration.folder.name if calibration.folder else "",
        "dataset": source.dataset,
        "dataset_sha256": source.dataset_sha256,
        "version": source.version,
    }
    poses = {f"poses_of_{effect.name}": ", ".join(effect.poses) for effect in calibration.effects}
    return {name: value for name, value in (values | poses).items() if value}


def effect_parameters(effect: Effect, warnings: list[Problem]) -> dict[str, Parameter]:
    """Return the ranges of an effect's parameters by full name; a list becomes a list of ranges.

    A parameter is drawn over its interval, evenly on the scale on which it is fitted, and within its bounds, at which
    an interval that is open on one side ends. Without an interval its fitted value stays, and where the interval is
    open on both sides, with a warning.
    """
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
