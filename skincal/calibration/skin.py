"""A calibration as a skin with effects, for the simulator: a whole session at once, or sample by sample."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from skincal.calibration.calibration import Calibration
from skincal.calibration.parts import Effect, Numbers
from skincal.effects import EffectSkin, SkinStream, effect
from skincal.effects.registry import Missing
from skincal.model.arrays import FloatArray


def skin_of(
    calibration: Calibration,
    resolution_m: float = 0.25e-3,
    margin_m: float = 8e-3,
    *,
    missing: Missing = "error",
    poses: Sequence[str] | None = None,
) -> EffectSkin:
    """Return the skin of a calibration, with its effects.

    Args:
        calibration: best parameters, and effects beyond the base model.
        resolution_m: longest edge of a tactile point's cell [m].
        margin_m: margin of the skin around the taxels [m].
        missing: policy for a missing covariate: an error, or the effect abstains.
        poses: names of the hand poses that samples number from 0 on; None: those that the calibration names, in its
            order.

    Raises:
        InputError: unknown effects or parameters, or values out of bounds.
        ValueError: the patch does not fit on its surface.
    """
    skin = calibration.base_skin(resolution_m, margin_m)
    return EffectSkin.of(skin, calibration.surface_model(), effects_of(calibration, poses), missing=missing)


def stream_of(
    calibration: Calibration,
    resolution_m: float = 0.25e-3,
    margin_m: float = 8e-3,
    *,
    missing: Missing = "error",
    poses: Sequence[str] | None = None,
) -> SkinStream:
    """Return :func:`skin_of` as a stream, for samples that arrive one by one: a simulated hand, an environment."""
    return SkinStream(skin_of(calibration, resolution_m, margin_m, missing=missing, poses=poses))


def effects_of(
    calibration: Calibration, poses: Sequence[str] | None = None
) -> dict[str, dict[str, FloatArray]]:
    """Return parameters by effect, in the form of :meth:`skincal.effects.EffectSkin.with_effects`.

    Args:
        calibration: calibration with or without effects.
        poses: as in :func:`skin_of`. A pose that the calibration does not know gets the neutral value.
    """
    return {
        one.name: {name: _array(one, name, value, poses) for name, value in one.parameters.items()}
        for one in calibration.effects
    }


def _array(one: Effect, name: str, value: Numbers, poses: Sequence[str] | None) -> FloatArray:
    """Return a parameter of an effect as an array, ordered by the given poses if it has one number per pose."""
    array = np.asarray(value, dtype=np.float64)
    parameter = next((p for p in effect(one.name).parameters if p.name == name), None)
    # Without poses the numbers stay as they are: an effect without its covariate abstains.
    if not poses or not one.poses or array.ndim == 0 or parameter is None or parameter.shape != "per-pose":
        return array
    known = dict(zip(one.poses, array.tolist(), strict=True))
    return np.array([known.get(pose, parameter.neutral) for pose in poses], dtype=np.float64)


def effect_from(
    name: str,
    parameters: Mapping[str, ArrayLike],
    intervals: Mapping[str, tuple[ArrayLike, ArrayLike]] | None = None,
    *,
    taxels: int,
    poses: Sequence[str] = (),
) -> Effect:
    """Return an effect of a calibration from the parameters of a skin with effects.

    Args:
        name: name of the effect.
        parameters: numbers, (J,) or (poses,) by parameter.
        intervals: low and high of some of them, of the same shape.
        taxels: number of taxels J.
        poses: names of the hand poses of lists.

    Raises:
        InputError: unknown effects or parameters, or values out of bounds.
    """
    effect(name).checked(parameters, taxels)
    per_pose = any(effect(name).parameter(p).shape == "per-pose" for p in parameters)
    return Effect(
        name,
        {key: _numbers(value) for key, value in parameters.items()},
        {key: (_numbers(low), _numbers(high)) for key, (low, high) in (intervals or {}).items()},
        poses=tuple(poses) if per_pose else (),
    )


def _numbers(value: ArrayLike) -> Numbers:
    """Return a number, or a tuple of numbers."""
    array = np.asarray(value, dtype=np.float64)
    return tuple(float(v) for v in array) if array.ndim else float(array)
