"""Ranges from a calibration: what it knows replaces the preset's figures; the rest stays as published.

Which figures of the preset a calibration replaces:

- The centre of the patch (``y_m`` with ``beta_deg``, or ``x_m`` on a plane), ``alpha_deg``, E and S: each
  becomes uniform over its interval. An offset of the preset (``y_offset_m``, ``x_offset_m``) stands for not
  knowing where the patch is; a calibrated centre takes its place.
- ``scale_per_taxel_per_n`` becomes a constant ``scale_offset_per_n``: S_j - S, so that S varies as a whole.
- Parameters of effects stand under ``skin.effects.NAME`` (:mod:`skincal.ranges.from_effects`). One that says so
  (``replaces_range``) takes the place of what the preset assumes of all taxels.

A parameter that the data leave unbounded has nothing to replace the preset's range with: that stays, assumed. Not so S:
it belongs to one sensor and its converter, so that without an interval of its own it is refused unless it is assumed.
Where the preset has none, or one that the sensor's mount rules out (its figures are those of the published
fingertip), the range that the mount allows is taken.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import isfinite
from typing import Final

import numpy as np

from skincal.calibration import Calibration, Effect
from skincal.effects import EFFECTS
from skincal.errors import InputError, Problem, WorkError
from skincal.ranges import presets
from skincal.ranges.from_effects import effect_parameters
from skincal.ranges.names import NAMES
from skincal.ranges.parameter import Parameter
from skincal.ranges.ranges import JointDraws, Ranges

DRAWS: Final = 500
"""Draws of the joint cloud that are kept, unless another number is asked for."""

_OFFSETS: Final = {"y_m": "y_offset_m", "x_m": "x_offset_m", "beta_deg": "x_offset_m"}
"""The preset's offset that stands for not knowing the parameter."""


def from_calibration(
    calibration: Calibration,
    preset: presets.PresetName | str = "iros24",
    *,
    joint: bool = False,
    draws: int = DRAWS,
    assumed_scale: tuple[float, float] | None = None,
) -> Ranges:
    """Ranges from a calibration and, for what it does not know, a preset.

    Args:
        calibration: what is known.
        preset: ``iros24`` or ``icra26``.
        joint: whether the cloud of draws from the valley is kept too, so that its columns are drawn together.
        draws: at most so many draws of the cloud are kept, evenly over its rows.
        assumed_scale: low and high of S [1/N] to assume where the calibration does not tell it.

    Returns:
        The ranges; their ``warnings`` name what the calibration leaves open, and what stands in its place.

    Raises:
        InputError: there is no such preset; or the cloud is asked for, and the calibration has none; or the assumed
            scale is no range.
        WorkError: the calibration does not tell S, and none is assumed. S belongs to one sensor and its converter: the
            preset's is that of another.
    """
    parameters = dict(presets.preset(preset))
    warnings: list[Problem] = []
    # On a plane the patch has no angle round the finger, off it no place across.
    flat = calibration.surface.kind == "plane"
    # Nor is a pad's y one along a finger, of which the preset speaks.
    for path in ("skin.beta_deg", "skin.y_m", "skin.alpha_deg") if flat else ("skin.x_m",):
        parameters.pop(path, None)
    for name in calibration.intervals:
        if f"skin.{name}" not in NAMES:  # the level at rest is of the session; a task has its own offsets
            continue
        if name == _SCALE and not calibration.identified(name):
            parameters[f"skin.{name}"] = Parameter.uniform(*_assumed_scale(calibration, assumed_scale))
            continue
        _replace(parameters, calibration, name, warnings)
    _add_scale_offsets(parameters, calibration)
    for effect in calibration.effects:
        parameters |= effect_parameters(effect, warnings)
        _take_the_place(parameters, effect, calibration.sensor.taxels)
    cloud = joint_draws(calibration, draws) if joint else None
    for column in cloud.columns if cloud else ():
        parameters.pop(_offset_path(column), None)
    return Ranges(parameters, cloud, _provenance(calibration, preset), warnings)


_SCALE: Final = "scale_per_n"


def _assumed_scale(calibration: Calibration, assumed: tuple[float, float] | None) -> tuple[float, float]:
    """The range of S that is assumed, of a calibration that does not tell it."""
    if assumed is None:
        low, high = calibration.intervals[_SCALE]
        raise WorkError(
            f"{calibration.folder or 'the calibration'}: the data do not tell the scale S (its interval is [{low:g}, "
            f"{high:g}]), and that of a preset belongs to another sensor and converter. Collect more presses and fit "
            "again, or say what to assume: --assume-scale LOW HIGH [counts per N]"
        )
    low, high = assumed
    if not (0 < low < high and isfinite(high)):
        raise InputError([Problem("--assume-scale", "0 < LOW < HIGH [counts per N]", f"{low:g} {high:g}")])
    return low, high


def joint_draws(calibration: Calibration, draws: int = DRAWS) -> JointDraws:
    """The cloud of draws from the valley.

    Args:
        calibration: with draws.
        draws: at most so many rows are kept, evenly spaced over those that there are.

    Raises:
        InputError: the calibration holds no draws, or draws that tell nothing, or fewer than one is asked for.
    """
    if draws < 1:
        raise InputError([Problem("draws", "a number above 0", str(draws))])
    if not any(calibration.identified(name) for name in calibration.intervals):
        place = f"{calibration.folder or 'the calibration'}/calibration.toml, [intervals]"
        fix = "Its draws tell nothing. Collect more presses; without the draws the preset's ranges are exported."
        raise InputError([Problem(place, "a parameter that the data tell", "none", fix)])
    if not calibration.draws:
        raise InputError(
            [
                Problem(
                    f"{calibration.folder or 'the calibration'}, draws.parquet",
                    "draws from the valley",
                    "no such file",
                    "Run skincal fit again, or export the box of intervals.",
                )
            ]
        )
    rows = np.column_stack(list(calibration.draws.values()))
    kept = np.unique(np.linspace(0, len(rows) - 1, min(draws, len(rows))).round().astype(int))
    return JointDraws([f"skin.{name}" for name in calibration.draws], rows[kept])


def _replace(
    parameters: dict[str, Parameter], calibration: Calibration, name: str, warnings: list[Problem]
) -> None:
    """Puts what the calibration knows of one parameter in the place of the preset's figures."""
    low, high = calibration.intervals[name]
    path = f"skin.{name}"
    if calibration.identified(name):
        parameters[path] = Parameter.uniform(low, high, source="calibrated")
        parameters.pop(_offset_path(path), None)
        return
    parameter, stand_in = _stand_in(parameters, calibration, name)
    parameters[path] = parameter
    warnings.append(
        Problem(
            f"calibration.toml, [intervals] {name}",
            "a bounded interval",
            f"[{low:g}, {high:g}]",
            f"The data do not tell {name}; {stand_in} takes its place, as assumed.",
        )
    )


def _stand_in(
    parameters: Mapping[str, Parameter], calibration: Calibration, name: str
) -> tuple[Parameter, str]:
    """What is assumed of a parameter that the data leave open, and what to call it."""
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
    """Full name of the offset that stands for not knowing a parameter; empty where there is none."""
    offset = _OFFSETS.get(path.removeprefix("skin."))
    return f"skin.{offset}" if offset else ""


def _mount(calibration: Calibration, name: str) -> tuple[tuple[float, float] | None, float]:
    """What ``[mount]`` allows (None where it says nothing), and the nominal value, else the best one."""
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
    """Whether the mount allows nothing of a published range: it is that of another fingertip."""
    low, high = published.low, published.high
    if allowed is None or not isinstance(low, float) or not isinstance(high, float):
        return False
    return high < allowed[0] or low > allowed[1]


def _add_scale_offsets(parameters: dict[str, Parameter], calibration: Calibration) -> None:
    scales = calibration.model.scale_per_taxel_per_n
    if scales is not None:
        common = calibration.model.scale_per_n
        # A taxel that does not answer must not with any S that is drawn.
        most = 2 * max(common, *(end for end in calibration.intervals["scale_per_n"] if isfinite(end)))
        if calibration.draws is not None:
            most = max(most, float(calibration.draws["scale_per_n"].max()))
        offsets = tuple(scale - common if scale > 0 else -most for scale in scales)
        parameters["skin.scale_offset_per_n"] = Parameter.constant(offsets, source="calibrated")


def _take_the_place(parameters: dict[str, Parameter], effect: Effect, taxels: int) -> None:
    """What is known of each taxel replaces what the preset assumes of all of them."""
    known = EFFECTS[effect.name]
    path = known.replaces_range
    if path not in parameters or parameters[path].source != "assumed":
        return
    if not known.is_neutral(known.checked(effect.parameters, taxels)):
        parameters[path] = Parameter.constant(0.0, source="calibrated")


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
