"""Conversions at the edge: files and people use degrees and millimetres, the core radians and metres."""

from __future__ import annotations

import math
import re

_COUNTS = re.compile(r"(?<![\w.-])counts(?![A-Za-z0-9_-])|(?<=1/)count\b")


def in_unit(text: str, unit: str | None) -> str:
    """Return a text about taxel values with their unit in the place of counts; None: counts."""
    return text if unit is None else _COUNTS.sub(lambda _: unit, text)


def deg(rad: float) -> float:
    """Radians to degrees."""
    return math.degrees(rad)


def rad(deg: float) -> float:
    """Degrees to radians."""
    return math.radians(deg)
