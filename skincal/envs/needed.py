"""Ranges that a task needs."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from skincal.errors import InputError, Problem
from skincal.ranges import NAMES, PRESETS, Ranges, preset, read_ranges
from skincal.tasks import ObjectName

_ALTERNATIVES: Final = {"skin.y_offset_m": ("skin.y_m",), "skin.x_offset_m": ("skin.beta_deg",)}
"""Alternatives to a preset's parameter: a calibrated centre for an offset from the nominal one."""
_EACH_STEP: Final = ("joint_noise_rad", "random_force_n", "taxel_noise_counts")
"""Parameters that may be drawn in each step."""


def ranges_for(kind: ObjectName, ranges: Ranges | str | Path | None) -> Ranges:
    """Ranges as given, from a file, of a preset by its name, or (None) the preset ``iros24``; checked for a task.

    Raises:
        InputError: the file cannot be read, or anything in it is wrong or missing.
    """
    if ranges is None or (isinstance(ranges, str) and ranges in PRESETS):
        ranges = preset(ranges or "iros24")
    if isinstance(ranges, Ranges):
        check_ranges(ranges, kind)
        return ranges
    found = read_ranges(ranges)
    check_ranges(found, kind, Path(ranges).name)
    return found


def check_ranges(ranges: Ranges, kind: ObjectName, place: str = "ranges") -> None:
    """Check that ranges hold all parameters of a task, and that they are drawn when the task can use them.

    They must hold all that the preset they started from randomizes of the task.

    Raises:
        InputError: naming every one that is missing, and what it is, and all that is drawn at the wrong time.
    """
    there = {*ranges, *(ranges.joint.columns if ranges.joint else ())}
    if "skin.x_m" in there:
        raise InputError([_flat(place, kind)])
    base = PRESETS.get(ranges.provenance.get("preset", ""), PRESETS["iros24"])
    found = [
        _missing(path, place)
        for path in base
        if path.startswith((f"object.{kind}.", "finger.", "skin."))
        and path not in there
        and not there.intersection(_ALTERNATIVES.get(path, ()))
    ]
    found += [
        Problem(f"{place}, [{path}] mode", "episode: the task does not draw it anew in each step", "step")
        for path, parameter in ranges.items()
        if parameter.mode == "step" and not path.endswith(_EACH_STEP)
    ]
    if found:
        raise InputError(found)


def _flat(place: str, kind: ObjectName) -> Problem:
    got = "those of a flat pad (skin.x_m instead of skin.beta_deg)"
    fix = (
        "The task has no flat fingertip: pose and E of a pad on a bench do not carry over to one that is bent. "
        "Calibrate the sensor on the finger (collect on the hand, or a stage with the fingertip), or take over "
        "skin.scale_per_n alone by hand."
    )
    return Problem(place, f"ranges of a skin on a round fingertip, as the {kind} task has", got, fix)


def _missing(path: str, place: str) -> Problem:
    name = NAMES[path]
    expected = f"{name.meaning} [{name.unit}]: distribution, mode, source, and figures"
    fix = f'Add the table; for a fixed value: distribution = "constant", value = … in {name.unit}.'
    return Problem(f"{place}, [{path}]", expected, "no such table", fix)
