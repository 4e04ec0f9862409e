"""The residuals of a fit by taxel, by force, by value, and over the session."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from skincal.dataset import Dataset
from skincal.dataset.dataset import session_times_s
from skincal.fitting.result import FitResult
from skincal.fitting.types import Floats
from skincal.model.arrays import BoolArray
from skincal.report import style

TOUCHED_COUNTS, TOUCHED_SIGMAS = 1.0, 4.0
"""A taxel is included if it reads, or should read, this many counts and this many times its noise."""

MOST_DOTS = 4000


@dataclass(frozen=True, eq=False)
class Residuals:
    """Simulated minus measured values (K, J) of the included taxels [counts]; NaN where a taxel is not included.

    ``touched`` (K, J) are those that were read, and are or should be active: at ``level_counts`` or more, measured or
    simulated, which noise alone does not reach.
    """

    difference: Floats
    touched: BoolArray
    level_counts: float

    @classmethod
    def of(cls, result: FitResult) -> Residuals:
        """Return the residuals at the best point; a saturated taxel that is simulated higher has none."""
        presses, problem = result.presses, result.problem
        level = max(TOUCHED_COUNTS, TOUCHED_SIGMAS * problem.noise_sigma_counts)
        touched = (problem.weight > 0) & (np.maximum(presses.observed, presses.simulated) >= level)
        difference = presses.simulated - presses.observed
        difference = np.where(problem.saturated & (difference > 0), 0.0, difference)
        return cls(np.where(touched, difference, np.nan), touched, level)

    @property
    def of_which(self) -> str:
        """Description of the included taxels, for the title of a figure."""
        return f"of taxels above noise (measured or simulated ≥ {self.level_counts:.2g} counts)"


@style.styled
def residuals_figure(result: FitResult, dataset: Dataset) -> Figure:
    """Draw the residuals of touched taxels: mean and rms by taxel; against force, value and session time."""
    found, problem = Residuals.of(result), result.problem
    force = np.broadcast_to(problem.force_n[:, None], found.touched.shape)
    figure = style.new_figure(11, 7.4, f"Residuals, simulated − measured, {found.of_which}")
    grid = figure.add_gridspec(2, 6)
    mean, rms = _by_taxel(found, np.mean), _by_taxel(found, lambda d: np.sqrt(np.mean(d**2)))
    # Residuals below the noise of a single reading must not look large.
    most = float(np.nanmax(np.abs(mean), initial=problem.noise_sigma_counts))
    top = float(np.nanmax(rms, initial=problem.noise_sigma_counts))
    places = [figure.add_subplot(grid[0, k : k + 2]) for k in (0, 2, 4)]
    for axes, values, norm, colours, title in (
        (places[0], mean, Normalize(-most, most), style.DIVERGING, "Mean by taxel [counts]"),
        (places[1], rms, Normalize(0.0, top), "YlGnBu", "rms by taxel [counts]"),
    ):
        boxes = style.draw_taxels(axes, problem.rig.layout, values, norm, colours)
        style.equal_axes_mm(axes, "u", "v")
        axes.set_title(title)
        figure.colorbar(boxes, ax=axes, shrink=0.8, pad=0.02)
    _draw_presses(places[2], result, dataset)
    below = [figure.add_subplot(grid[1, k : k + 3]) for k in (0, 3)]
    _draw_against(below[0], force[found.touched], found, "measured force [N]", "Against force")
    simulated = result.presses.simulated[found.touched]
    _draw_against(below[1], simulated, found, "simulated value [counts]", "Against value")
    return figure


@style.styled
def scatter_figure(result: FitResult) -> Figure:
    """Draw measured against simulated values, and the distribution of the residuals."""
    found = Residuals.of(result)
    observed, simulated = result.presses.observed[found.touched], result.presses.simulated[found.touched]
    bad = np.broadcast_to(~result.presses.good[:, None], found.touched.shape)[found.touched]
    figure = style.new_figure(11, 5.2, f"Measured against simulated values {found.of_which}")
    axes, distribution = figure.subplots(1, 2)
    low = float(min(observed.min(initial=0.0), 0.0))
    high = 1.05 * float(max(observed.max(initial=1.0), simulated.max(initial=1.0)))
    axes.plot([low, high], [low, high], color=style.GREY, linewidth=0.8, label="equal")
    some, dots = slice(None, None, max(1, len(observed) // MOST_DOTS)), {"alpha": 0.6, "markersize": 5}
    axes.plot(simulated[some], observed[some], ".", color=style.BLUE, label="taxel of a press", **dots)
    if bad.any():
        axes.plot(simulated[bad], observed[bad], "x", color=style.RED, markersize=5, label="of a bad press")
    axes.set(xlabel="simulated [counts]", ylabel="measured, above rest [counts]", aspect="equal")
    axes.set(xlim=(low, high), ylim=(low, high))
    axes.legend(loc="upper left")
    _draw_distribution(distribution, result, found)
    return figure


def _draw_distribution(axes: Axes, result: FitResult, found: Residuals) -> None:
    values = found.difference[found.touched]
    sigma, floor = result.sigmas.noise_counts, result.problem.noise_sigma_counts
    reach = max(float(np.quantile(np.abs(values), 0.99)) if len(values) else 0.0, 4 * sigma)
    edges = np.linspace(-reach, reach, 41)
    axes.hist(np.clip(values, -reach, reach), bins=list(edges), color=style.BLUE, density=True)
    at = np.linspace(-reach, reach, 201)
    for width, colour, words in (
        (sigma, style.ORANGE, f"normal, estimated scatter: {sigma:.2g} counts"),
        (floor, style.BLACK, f"normal, noise of untouched taxels: {floor:.2g} counts"),
    ):
        line = "--" if colour == style.BLACK else "-"
        density = np.exp(-0.5 * (at / width) ** 2) / (width * np.sqrt(2 * np.pi))
        axes.plot(at, density, color=colour, linestyle=line, label=words)
    if outside := int((np.abs(values) > reach).sum()):
        axes.plot([], [], " ", label=f"{outside} beyond, in the outermost bars")
    axes.set(xlabel="simulated − measured [counts]", ylabel="density [1/count]")
    axes.margins(y=0.35)
    axes.legend(loc="upper left")


def _by_taxel(found: Residuals, of: Any) -> Floats:
    """Return a statistic of every taxel's residuals (J,); NaN where it was never included."""
    values = np.full(found.touched.shape[1], np.nan)
    for j in np.flatnonzero(found.touched.any(axis=0)):
        values[j] = of(found.difference[found.touched[:, j], j])
    return values


def _draw_presses(axes: Axes, result: FitResult, dataset: Dataset) -> None:
    """Draw the error of the presses over the session: a trend is a drift."""
    rows, presses = result.problem.rows, result.presses
    times = session_times_s(dataset)
    x = rows.astype(np.float64) if times is None else times[rows]
    good = presses.good
    axes.plot(x[good], presses.rmse_counts[good], "o", color=style.BLUE, markersize=3.5, label="good")
    if not good.all():
        axes.plot(x[~good], presses.rmse_counts[~good], "D", color=style.RED, markersize=5, label="bad")
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.1, ncols=2)
    axes.set_xlabel("press, in the order of the table" if times is None else "session time [s]")
    axes.set(title="Over the session", ylabel="rmse of a press [counts]")
    axes.set_ylim(bottom=0)
    axes.margins(y=0.2)
    axes.grid(axis="y")


def _draw_against(axes: Axes, x: Floats, found: Residuals, label: str, title: str) -> None:
    y = found.difference[found.touched]
    some = slice(None, None, max(1, len(y) // MOST_DOTS))
    axes.axhline(0, color=style.GREY, linewidth=0.8)
    axes.plot(x[some], y[some], ".", color=style.BLUE, alpha=0.5, markersize=4, label="taxel of a press")
    edges = np.unique(np.quantile(x, np.linspace(0, 1, 8))) if len(x) >= 16 else np.empty(0)
    if len(edges) > 2:
        part = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, len(edges) - 2)
        groups = [np.flatnonzero(part == k) for k in range(len(edges) - 1)]
        middle = np.array([np.median(x[g]) for g in groups if len(g)])
        low, half, high = np.array([np.quantile(y[g], [0.16, 0.5, 0.84]) for g in groups if len(g)]).T
        axes.fill_between(middle, low, high, color=style.ORANGE, alpha=0.3, linewidth=0, label="middle 68 %")
        axes.plot(middle, half, "o-", color=style.ORANGE, markersize=4, label="median")
    reach = 1.35 * float(np.quantile(np.abs(y), 0.995)) if len(y) else 1.0
    axes.set_ylim(-max(reach, 0.1), max(reach, 0.1))
    beyond = int((np.abs(y) > reach).sum())
    axes.set_title(title + (f" ({beyond} beyond the axis)" if beyond else ""))
    axes.set(xlabel=label, ylabel="residual [counts]")
    axes.grid(axis="y")
    axes.legend(loc="upper right", ncols=3)
