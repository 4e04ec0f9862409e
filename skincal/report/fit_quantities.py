"""The five parameters of a fit in readable units (mm, degrees, MPa/m), with as many digits as are known."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from skincal.fitting.result import PARAMETERS, FitResult
from skincal.fitting.types import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True, eq=False)
class Quantity:
    """A parameter of a fit, in the unit of figures and tables.

    Attributes:
        name: name in the fit, one of ``PARAMETERS``.
        label: displayed name.
        factor: converts the fit's SI value to that unit.
        low: lower end of the interval; -inf if the data do not bound it.
        high: upper end; inf if the data do not bound it.
        searched: low and high of the searched range; None for S, which is solved analytically.
        draws: (N,) posterior draws.
    """

    name: str
    label: str
    unit: str
    factor: float
    best: float
    low: float
    high: float
    searched: tuple[float, float] | None
    draws: Floats

    @property
    def identified(self) -> bool:
        """True if the data bound the parameter on both sides."""
        return math.isfinite(self.low) and math.isfinite(self.high)

    @property
    def axis_label(self) -> str:
        """Name and unit, for an axis."""
        return f"{self.label} [{self.unit}]"

    @property
    def logarithmic(self) -> bool:
        """True if the parameter is searched, and drawn over its whole range, on a logarithmic scale."""
        return self.name == "elasticity_pa_per_m"

    @property
    def best_text(self) -> str:
        """Best value with its unit."""
        return f"{self.shown(self.best)} {self.unit}".replace(" °", "°")

    @property
    def bar_percent(self) -> tuple[float, float]:
        """Start and width of the interval in the searched range."""
        ends = np.array(self.searched)
        interval = np.array([self.low, self.high]) if self.identified else ends
        if self.logarithmic:
            ends, interval = np.log(ends), np.log(interval)
        start, end = 100 * np.clip((interval - ends[0]) / (ends[1] - ends[0]), 0.0, 1.0)
        return float(start), float(end - start)

    def shown(self, value: float) -> str:
        """Return a value with so many digits that the interval's width has two."""
        width = self.high - self.low if self.identified else abs(self.best) / 10
        return with_digits(value, width)


def quantities(result: FitResult) -> tuple[Quantity, ...]:
    """Return the parameters of a fit in reading order: pose, elasticity, scale."""
    radius = result.problem.rig.arc_radius_m
    across = ("x", "mm", 1e3) if radius is None else ("beta", "°", math.degrees(1.0 / radius))
    shown = {
        "y_m": ("y", "mm", 1e3),
        "across_m": across,
        "alpha_rad": ("alpha", "°", math.degrees(1.0)),
        "elasticity_pa_per_m": ("E", "MPa/m", 1e-6),
        "scale_per_n": ("S", "1/N", 1.0),
    }
    found: list[Quantity] = []
    for name, (label, unit, factor) in shown.items():
        searched = getattr(result.box, name, None)
        low, high = (factor * end for end in result.intervals[name])
        box = None if searched is None else (searched[0] * factor, searched[1] * factor)
        draws = result.draws[:, PARAMETERS.index(name)] * factor
        found.append(Quantity(name, label, unit, factor, result.best[name] * factor, low, high, box, draws))
    return tuple(found)


def with_digits(value: float, width: float) -> str:
    """Return a value with so many decimals that a width has two significant digits: 24.30 for a width of 0.5."""
    if not math.isfinite(value):
        return "−∞" if value < 0 else "∞"
    if not (math.isfinite(width) and width > 0):
        return f"{value:.4g}"
    decimals = max(0, 1 - math.floor(math.log10(width)))
    # Tiny negative values are zero.
    return f"{round(value, decimals) + 0.0:.{min(decimals, 9)}f}".replace("-", "−")


def label_panel(axes: Axes, x_label: str, y_label: str, *, bottom: bool, left: bool) -> None:
    """Label a panel of a triangle: x in the lowest row, y in the first column."""
    if bottom:
        axes.set_xlabel(x_label)
    else:
        axes.tick_params(labelbottom=False)
    if left:
        axes.set_ylabel(y_label)
    else:
        axes.tick_params(labelleft=False)
