"""How much narrower a calibration makes the ranges of a preset."""

from __future__ import annotations

import math
from dataclasses import dataclass

from skincal.ranges.parameter import Parameter
from skincal.ranges.ranges import Ranges


@dataclass(frozen=True)
class Narrowing:
    """One calibrated parameter beside the preset's.

    Attributes:
        path: full name.
        parameter: what the calibration says.
        published: what the preset says; None where it does not randomize it.
        ratio: width over the preset's width; above 1 the calibration is wider, nan where there is none.
    """

    path: str
    parameter: Parameter
    published: Parameter | None
    ratio: float


_POSE = ("skin.x_m", "skin.y_m", "skin.alpha_deg")
"""Where a flat pad lies on its bench; a preset's is where a fingertip's patch lies on its finger."""


def narrowing(ranges: Ranges, published: Ranges) -> tuple[Narrowing, ...]:
    """Every calibrated parameter of some ranges beside that of a preset, in the order of the names."""
    rows: list[Narrowing] = []
    flat = "skin.x_m" in ranges
    for path in ranges.calibrated():
        # A preset that only knows an offset of the centre states the width of its range by that.
        other = published.get(path, published.get(path.replace("_m", "_offset_m")))
        if flat and path in _POSE:
            other = None
        width = other.width() if other is not None else math.nan
        ratio = ranges[path].width() / width if width > 0.0 else math.nan
        rows.append(Narrowing(path, ranges[path], other, ratio))
    return tuple(rows)
