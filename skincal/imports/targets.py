"""The columns of a dataset that a mapping may fill, their kinds and groups, and the units of their sources."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from skincal.covariates import COLUMNS, NORMAL, POSITION, TARGET, TEXT, TIMES, WHOLE
from skincal.dataset.columns import JOINT, OPTIONAL
from skincal.units import FORCES_N, LENGTHS_M


@dataclass(frozen=True)
class Unit:
    """A unit of a source: ``SI = factor * value + offset``; only temperatures have an offset."""

    name: str
    factor: float = 1.0
    offset: float = 0.0


LENGTH, FORCE, ANGLE, TIME = "length", "force", "angle", "time"
TORQUE, SPEED, TEMPERATURE, NONE = "torque", "speed", "temperature", "number"

DATETIME: Final = "datetime"
"""Instead of a unit of time: dates with times, like 2026-11-20 12:00:00.250."""

FACTORS: Final[dict[str, dict[str, float]]] = {
    LENGTH: LENGTHS_M,
    FORCE: FORCES_N,
    ANGLE: {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180, "turn": 2 * math.pi},
    TIME: {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "d": 86400.0, DATETIME: 1.0},
    TORQUE: {"N m": 1.0, "mN m": 1e-3, "N mm": 1e-3, "N cm": 1e-2, "kgf cm": FORCES_N["kgf"] / 100},
    SPEED: {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3, "um/s": 1e-6, "mm/min": 1e-3 / 60, "inch/s": LENGTHS_M["inch"]},
    TEMPERATURE: {"C": 1.0, "K": 1.0, "F": 5 / 9},
    NONE: {"1": 1.0},
}  # fmt: skip
"""Units in SI (degrees Celsius for temperatures), by the kind of quantity."""

_ZEROS = {"K": -273.15, "F": -32 * 5 / 9}
_ALIASES = {
    "in": "inch", "µm": "um", "μm": "um", "µs": "us", "μs": "us", "Nm": "N m", "N*m": "N m", "mNm": "mN m",
    "Nmm": "N mm", "Ncm": "N cm", "°C": "C", "degC": "C", "°F": "F", "degF": "F", "°": "deg", "degrees": "deg",
    "radians": "rad", "sec": "s", "g": "gf", "kg": "kgf", "kp": "kgf", "lb": "lbf", "lbs": "lbf", "oz": "ozf",
}  # fmt: skip


def unit_of(kind: str, name: str) -> Unit | None:
    """Return the unit of a quantity by its name; None if unknown."""
    name = _ALIASES.get(name, name)
    factor = FACTORS[kind].get(name)
    return None if factor is None else Unit(name, factor, _ZEROS.get(name, 0.0))


def other_kind(name: str) -> str | None:
    """Return the kind of quantity of a unit; None for an unknown unit."""
    name = _ALIASES.get(name, name)
    return next((kind for kind, units in FACTORS.items() if name in units), None)


def si_unit(kind: str) -> Unit:
    """Return the unit that the dataset itself has: the first of a kind."""
    return Unit(next(iter(FACTORS[kind])))


VECTORS: Final = {"position": POSITION, "normal": NORMAL, "target": TARGET}
"""Names that stand for three columns at once in a mapping."""

PRESSES, SERIES = "presses", "series"
"""Meaning of a row of the source: a whole press, or one sample of a time series."""

_KINDS: Final = {
    **{name: column.quantity for name, column in COLUMNS.items() if column.quantity != NONE},
    **dict.fromkeys(POSITION, LENGTH),
    "force_n": FORCE,
    **dict.fromkeys((*TIMES, "time_s"), TIME),
}

_ENDS: Final = {
    "_m_per_s": SPEED, "_m": LENGTH, "_n": FORCE, "_s": TIME, "_rad": ANGLE,
}  # fmt: skip
"""Kinds of quantities of other columns, by the unit at the end of their names."""

LABELS: Final = tuple(name for name, column in COLUMNS.items() if column.of_press)
"""Columns that describe a whole press and are not averaged over its hold."""


def quantity_of(target: str) -> str:
    """Return the kind of quantity of a column; plain numbers for one without a unit."""
    if joint := JOINT.fullmatch(target):
        return ANGLE if joint[1] == "q" else TORQUE
    by_name = next((kind for end, kind in _ENDS.items() if target.endswith(end)), NONE)
    return _KINDS.get(target, NONE if target in OPTIONAL else by_name)


def needs_unit(target: str) -> bool:
    """Return whether the source of a column has to name its unit; columns of other names may."""
    return target in _KINDS or JOINT.fullmatch(target) is not None


def is_text(target: str) -> bool:
    """Return whether a column holds words."""
    return target == "phase" or OPTIONAL.get(target) == TEXT


def is_whole(target: str) -> bool:
    """Return whether a column holds whole numbers."""
    return target == "press" or OPTIONAL.get(target) == WHOLE


def known_targets(rows: str) -> tuple[str, ...]:
    """Return the columns that sources with such rows may fill, without joints."""
    own = ("press", *TIMES) if rows == PRESSES else ("time_s", "press", "phase")
    return (*own, *POSITION, "force_n", *OPTIONAL)


def required_targets(rows: str, *, positions: bool) -> tuple[str, ...]:
    """Return the columns that a mapping must fill; ``positions``: whether positions are known."""
    return (*(("time_s",) if rows == SERIES else ()), *(POSITION if positions else ()), "force_n")
