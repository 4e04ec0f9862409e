"""The report of a fit: one self-contained page, with its figures as files, and its parameters in readable units."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from skincal.calibration import Calibration
from skincal.dataset import Dataset
from skincal.fitting.problem import USED
from skincal.fitting.result import PARAMETERS, FitResult
from skincal.fitting.types import Floats
from skincal.report.page import Picture, percent, picture, write_page

if TYPE_CHECKING:
    from matplotlib.figure import Figure


EXPLAINED = 1.5
"""Residuals up to this multiple of the noise count as explained."""


def _figure(stem: str, result: FitResult, dataset: Dataset) -> Figure:
    """Draw a figure; what draws is loaded here, so that other processes draw while this one loads it."""
    from skincal.report.fit_images import images_figure
    from skincal.report.fit_residuals import residuals_figure, scatter_figure
    from skincal.report.fit_slack import slack_figure
    from skincal.report.fit_valley import draws_figure, valley_figure

    of_result = {"valley": valley_figure, "draws": draws_figure, "scatter": scatter_figure}
    of_both = {"images": images_figure, "slack": slack_figure, "residuals": residuals_figure}
    return of_result[stem](result) if stem in of_result else of_both[stem](result, dataset)


FIGURES: Mapping[str, Callable[[FitResult, Dataset], Figure]] = {
    stem: partial(_figure, stem) for stem in ("valley", "draws", "images", "slack", "residuals", "scatter")
}
"""Figures of the page, by the name of their file."""


def write_fit_report(
    result: FitResult,
    calibration: Calibration,
    dataset: Dataset,
    folder: str | Path,
    spread: Callable[[Callable[[Any], Any], Sequence[Any]], Iterable[Any]] = map,
) -> None:
    """Write ``report.html`` and its figures (``valley.png`` ...) into a folder.

    The page contains its figures and needs nothing from elsewhere; it can be sent as a single file.
    """
    folder, without_frames = Path(folder), replace(dataset, frames=None)
    problem, grid, level = result.problem, result.grid, calibration.provenance.options.get("level")
    declared_m = problem.rig.position_sigma_m
    slack_m = result.presses.slack_m
    write_page(
        "fit.html",
        folder,
        dataset,
        calibration,
        result=result,
        quantities=quantities(result),
        unused=why_unused(result),
        scales=_scales(result),
        explained=result.sigmas.noise_counts <= max(EXPLAINED * problem.noise_sigma_counts, 0.5),
        bad=int((~result.presses.good).sum()),
        slack_rms_mm=1e3 * float(np.sqrt(np.mean(slack_m**2))) if len(slack_m) else 0.0,
        inside=int(grid.in_valley.sum()),
        combinations=grid.grid.combinations,
        as_good=int((grid.mse_counts2 <= grid.mse_at_best_counts2).sum()),
        level=percent(level) if isinstance(level, int | float) else "part",
        declared_m=declared_m if np.isfinite(declared_m) else None,
        presses=_presses(result, dataset),
        figures=list(spread(_picture, [(stem, result, without_frames, folder) for stem in FIGURES])),
    )


def _picture(of: tuple[str, FitResult, Dataset, Path]) -> Picture:
    stem, result, dataset, folder = of
    return picture(FIGURES[stem](result, dataset), stem, folder, dataset.meta.sensor.unit)


def why_unused(result: FitResult) -> list[tuple[str, int]]:
    """Return the reasons why presses were not used, with their numbers, the most frequent first."""
    return Counter(status for status in result.problem.status if status != USED).most_common()


def _scales(result: FitResult) -> dict[str, str] | None:
    """Return the least and the largest scale of a taxel with its row and column, and how much they differ."""
    scales = result.scale_per_taxel_per_n
    if scales is None:
        return None
    names, ends = result.problem.rig.layout.names, (int(np.argmin(scales)), int(np.argmax(scales)))
    least, most = (f"{scales[j]:.3g} of taxel {names([j])}" for j in ends)
    return {"least": least, "most": most, "percent": f"{100 * float(np.std(np.log(scales))):.2g}"}


def _presses(result: FitResult, dataset: Dataset) -> list[tuple[str, ...]]:
    """Return number, force, active taxels, outcome, slack and rmse of all presses, in the order of the dataset."""
    problem, presses = result.problem, result.presses
    place = {int(row): k for k, row in enumerate(problem.rows)}
    rows: list[tuple[str, ...]] = []
    for row, (number, status) in enumerate(zip(dataset.presses.press, problem.status, strict=True)):
        start = str(number), f"{dataset.presses.force_n[row]:.3g}", str(int(problem.active[row]))
        k = place.get(row)
        if k is None:
            rows.append((*start, status, "", "", ""))
            continue
        slack = (with_digits(1e3 * v, 1.0) for v in presses.slack_m[k])
        outcome = "used" if presses.good[k] else "used, matches badly"
        rows.append((*start, outcome, *slack, f"{presses.rmse_counts[k]:.2g}"))
    return rows


@dataclass(frozen=True, eq=False)
class Quantity:
    """A parameter of a fit (one of ``PARAMETERS``), in the unit of figures and tables; ``factor`` converts to it.

    Ends of the interval are infinite where the data do not bound it. ``searched`` is None for S, which is solved
    analytically; ``draws`` (N,) are posterior draws.
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
