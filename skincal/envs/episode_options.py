"""Options of an episode: ``reset(options={...})``."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, Final, cast

import numpy as np
from numpy.typing import ArrayLike

from skincal.dataset.findings import did_you_mean
from skincal.envs.trajectories import BOLT_HZ, FIXED
from skincal.errors import InputError, Problem
from skincal.model.arrays import FloatArray

JOINT_OFFSETS: Final = ("finger.joint_offset_rad",)
"""All that the paper randomizes in its evaluation."""


@dataclass(frozen=True)
class EpisodeOptions:
    """Options of an episode.

    Attributes:
        trajectory: of the marble: ``random``, ``circle`` (the evaluation), ``still``, or targets (N, 2) in patch
            coordinates at 10 Hz [m], the last of which stays.
        duration_s: the time-out [s]; None: 6 s, of the circle 8 s.
        randomize: ``all``, ``none``, or names of parameters and tables that are randomized, the rest being nominal.
        values: values by full name that take the place of draws.
        orientation_deg: of the bolt [°]; None: drawn from the four.
        frequency_hz: of the bolt's sine [Hz]; None: drawn.
        pellets: how many there are; None: drawn.
    """

    trajectory: str | FloatArray = "random"
    duration_s: float | None = None
    randomize: Sequence[str] | None = None
    values: Mapping[str, ArrayLike] = field(default_factory=dict[str, ArrayLike])
    orientation_deg: float | None = None
    frequency_hz: float | None = None
    pellets: float | None = None


def read_options(options: Mapping[str, Any] | None) -> EpisodeOptions:
    """Return options from a mapping, as ``reset`` takes it.

    Raises:
        InputError: unknown keys, or values that make no sense; all of them.
    """
    given = dict(options or {})
    known = [item.name for item in fields(EpisodeOptions)]
    found: list[Problem] = []
    for key in given:
        if key not in known:
            close = did_you_mean(str(key), known)
            fix = f'Did you mean "{close}"?' if close else ""
            found.append(Problem(f"options {key}", f"one of {', '.join(known)}", "an unknown key", fix))
    out: dict[str, Any] = {
        "trajectory": _trajectory(given.get("trajectory", "random"), found),
        "randomize": _names(given.get("randomize", "all"), found),
        "values": _values(given.get("values", {}), found),
        "duration_s": _number("duration_s", given.get("duration_s"), 0.1, 3600.0, found),
        "orientation_deg": _number("orientation_deg", given.get("orientation_deg"), -360.0, 360.0, found),
        "pellets": _number("pellets", given.get("pellets"), 2, 3, found),
        "frequency_hz": _number("frequency_hz", given.get("frequency_hz"), 0.0, 10 * BOLT_HZ[1], found),
    }
    if found:
        raise InputError(found)
    return EpisodeOptions(**out)


def _trajectory(value: Any, found: list[Problem]) -> str | FloatArray:
    choices = ("random", *FIXED)
    expected = f"one of {', '.join(choices)}, or targets (N, 2) within 0.05 m"
    if isinstance(value, str):
        if value not in choices:
            found.append(Problem("options trajectory", expected, repr(value)))
        return value
    targets = np.zeros((0, 0))
    with contextlib.suppress(TypeError, ValueError):
        targets = np.array(value, dtype=np.float64)
    if targets.ndim != 2 or targets.shape[-1] != 2 or not len(targets) or not (np.abs(targets) <= 0.05).all():
        found.append(Problem("options trajectory", expected, f"shape {targets.shape}"))
    return targets


def _names(value: object, found: list[Problem]) -> tuple[str, ...] | None:
    if value is None or value == "all":
        return None
    if value == "none":
        return ()
    items = cast("Sequence[object]", value) if isinstance(value, list | tuple) else (None,)
    if all(isinstance(item, str) for item in items):
        return tuple(str(item) for item in items)
    expected = '"all", "none", or a list of names of parameters and tables'
    found.append(Problem("options randomize", expected, repr(cast(object, value))))
    return None


def _values(value: Any, found: list[Problem]) -> Mapping[str, ArrayLike]:
    if isinstance(value, Mapping):
        return cast("Mapping[str, ArrayLike]", value)
    found.append(Problem("options values", "values by full name: {'skin.y_m': 0.0235}", repr(value)))
    return {}


def _number(name: str, value: object, low: float, high: float, found: list[Problem]) -> float | None:
    if value is None:
        return None
    if isinstance(value, int | float | np.floating | np.integer) and not isinstance(value, bool):
        number = float(cast(float, value))
        if low <= number <= high:
            return number
    expected = f"a number between {low:g} and {high:g}"
    found.append(Problem(f"options {name}", expected, repr(cast(object, value))))
    return None
