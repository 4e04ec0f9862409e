"""The columns of a dataset that a mapping may fill: their kinds and their groups."""

from __future__ import annotations

from typing import Final

from skincal.covariates import COLUMNS, NORMAL, POSITION, TARGET, TEXT, TIMES, WHOLE
from skincal.dataset.columns import JOINT, OPTIONAL
from skincal.imports import units

VECTORS: Final = {"position": POSITION, "normal": NORMAL, "target": TARGET}
"""Names that stand for three columns at once in a mapping."""

PRESSES, SERIES = "presses", "series"
"""Meaning of a row of the source: a whole press, or one sample of a time series."""

_KINDS: Final = {
    **{name: column.quantity for name, column in COLUMNS.items() if column.quantity != units.NONE},
    **dict.fromkeys(POSITION, units.LENGTH),
    "force_n": units.FORCE,
    **dict.fromkeys((*TIMES, "time_s"), units.TIME),
}

_ENDS: Final = {
    "_m_per_s": units.SPEED, "_m": units.LENGTH, "_n": units.FORCE, "_s": units.TIME, "_rad": units.ANGLE,
}  # fmt: skip
"""Kinds of quantities of other columns, by the unit at the end of their names."""

LABELS: Final = tuple(name for name, column in COLUMNS.items() if column.of_press)
"""Columns that describe a whole press and are not averaged over its hold."""


def quantity_of(target: str) -> str:
    """Return the kind of quantity of a column; plain numbers for one without a unit."""
    if joint := JOINT.fullmatch(target):
        return units.ANGLE if joint[1] == "q" else units.TORQUE
    by_name = next((kind for end, kind in _ENDS.items() if target.endswith(end)), units.NONE)
    return _KINDS.get(target, units.NONE if target in OPTIONAL else by_name)


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
