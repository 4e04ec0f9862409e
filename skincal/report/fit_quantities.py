"""The five parameters of a fit as a person reads them: millimetres, degrees, MPa/m, as many digits as are known."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skincal.fitting.result import PARAMETERS, FitResult

FloatArray = NDArray[np.floating[Any]]


@dataclass(frozen=True, eq=False)
class Quantity:
    """One parameter of a fit, in the unit of figures and tables.

    Attributes:
        name: its name in the fit, one of ``PARAMETERS``.
        label: its name for a person.
        unit: the unit it is shown in.
        factor: takes the fit's SI value to that unit.
        best: the best value.
        low: lower end of its interval; -inf where the data say nothing.
        high: upper end; inf where the data say nothing.
        searched: low and high of the range that was searched; None for S, which is found analytically.
        draws: (N,) values drawn from the valley.
    """

    name: str
    label: str
    unit: str
    factor: float
    best: float
    low: float
    high: float
    searched: tuple[float, float] | None
    draws: FloatArray

    @property
    def identified(self) -> bool:
        """Whether the data bound it on both sides."""
        return math.isfinite(self.low) and math.isfinite(self.high)

    @property
    def axis_label(self) -> str:
        """Name and unit, for an axis."""
        return f"{self.label} [{self.unit}]"

    @property
    def logarithmic(self) -> bool:
        """Whether it is searched, and drawn over its whole range, by its logarithm."""
        return self.name == "elasticity_pa_per_m"

    def shown(self, value: float) -> str:
        """Return a value with so many digits that the interval's width has two."""
        width = self.high - self.low if self.identified else abs(self.best) / 10
        return with_digits(value, width)


def quantities(result: FitResult) -> tuple[Quantity, ...]:
    """Return the parameters of a fit in the order in which people read them: pose, elasticity, scale."""
    radius = result.problem.rig.arc_radius_m
    across = ("x", "mm", 1e3) if radius is None else ("beta", "°", math.degrees(1.0 / radius))
    shown = {
        "y_m": ("y", "mm", 1e3),
        "across_m": across,
        "alpha_rad": ("alpha", "°", math.degrees(1.0)),
        "elasticity_pa_per_m": ("E", "MPa/m", 1e-6),
        "scale_per_n": ("S", "1/N", 1.0),
    }
    return tuple(_quantity(result, name, *words) for name, words in shown.items())


def _quantity(result: FitResult, name: str, label: str, unit: str, factor: float) -> Quantity:
    searched = getattr(result.box, name, None)
    low, high = result.intervals[name]
    return Quantity(
        name,
        label,
        unit,
        factor,
        result.best[name] * factor,
        low * factor,
        high * factor,
        None if searched is None else (searched[0] * factor, searched[1] * factor),
        result.draws[:, PARAMETERS.index(name)] * factor,
    )


def with_digits(value: float, width: float) -> str:
    """Return a value with so many decimals that a width has two significant digits: 24.30 for a width of 0.5."""
    if not math.isfinite(value):
        return "−∞" if value < 0 else "∞"
    if not (math.isfinite(width) and width > 0):
        return f"{value:.4g}"
    decimals = max(0, 1 - math.floor(math.log10(width)))
    # A hair below zero is zero.
    return f"{round(value, decimals) + 0.0:.{min(decimals, 9)}f}".replace("-", "−")
