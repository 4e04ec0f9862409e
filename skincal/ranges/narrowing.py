"""Narrowing: how much narrower a calibration makes the ranges of a preset."""

from __future__ import annotations

import math
from dataclasses import dataclass

from skincal.ranges.parameter import Parameter
from skincal.ranges.ranges import Ranges


@dataclass(frozen=True)
class Narrowing:
    """A calibrated parameter and the preset's range of it.

    Attributes:
        path: full name.
        parameter: the calibrated range.
        published: the preset's range; None where the preset does not randomize it.
        ratio: calibrated width over the preset's; above 1 the calibration is wider; nan without a preset's width.
    """

    path: str
    parameter: Parameter
    published: Parameter | None
    ratio: float


_SCALE = "skin.scale_per_n"
"""It belongs to a converter: volts or 12 bits per newton do not compare with counts of 8 bits per newton."""

_POSE = ("skin.x_m", "skin.y_m", "skin.alpha_deg")
"""Parameters that place a flat pad on its bench; a preset's place a fingertip's patch on its finger."""


def narrowing(ranges: Ranges, published: Ranges, *, same_converter: bool = True) -> tuple[Narrowing, ...]:
    """Return every calibrated parameter with the preset's range of it, in the order of the names.

    Args:
        ranges: ranges of a calibration.
        published: ranges of a preset.
        same_converter: whether the sensor counts as the published one does; else its S is not compared.
    """
    rows: list[Narrowing] = []
    flat = "skin.x_m" in ranges
    for path in ranges.calibrated():
        # A preset that knows only an offset of the centre states the width of its range by that offset.
        other = published.get(path, published.get(path.replace("_m", "_offset_m")))
        if (flat and path in _POSE) or (not same_converter and path == _SCALE):
            other = None
        width = other.width() if other is not None else math.nan
        ratio = ranges[path].width() / width if width > 0.0 else math.nan
        rows.append(Narrowing(path, ranges[path], other, ratio))
    return tuple(rows)
