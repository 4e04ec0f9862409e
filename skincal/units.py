"""Conversions at the edge: files and people use degrees and millimetres, the core radians and metres."""

from __future__ import annotations

import math

MM = 1e-3
"""One millimetre in metres."""


def deg(rad: float) -> float:
    """Radians to degrees."""
    return math.degrees(rad)


def rad(deg: float) -> float:
    """Degrees to radians."""
    return math.radians(deg)
