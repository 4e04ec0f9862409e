"""Units, and conversions at the edge: files and people use degrees and millimetres, the core radians and metres."""

from __future__ import annotations

import math
import re
from typing import Final

_GRAVITY, _POUND_KG, _INCH_M = 9.80665, 0.45359237, 0.0254
"""Standard gravity [m/s²] (BIPM, SI brochure), the international pound and the inch; all are exact."""

LENGTHS_M: Final = {
    "m": 1.0, "dm": 0.1, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "nm": 1e-9, "inch": _INCH_M, "mil": _INCH_M / 1000,
}  # fmt: skip
FORCES_N: Final = {
    "N": 1.0, "kN": 1e3, "cN": 1e-2, "mN": 1e-3, "uN": 1e-6, "gf": 1e-3 * _GRAVITY, "kgf": _GRAVITY,
    "lbf": _POUND_KG * _GRAVITY, "ozf": _POUND_KG * _GRAVITY / 16, "dyn": 1e-5,
}  # fmt: skip
"""Units of length and of force, in metres and in newtons; imports and checks of datasets use them."""

_COUNTS = re.compile(r"(?<![\w.-])counts(?![A-Za-z0-9_-])|(?<=1/)count\b")


def in_unit(text: str, unit: str | None) -> str:
    """Return a text about taxel values with their unit in the place of counts; None: counts."""
    return text if unit is None else _COUNTS.sub(lambda _: unit, text)


deg, rad = math.degrees, math.radians
