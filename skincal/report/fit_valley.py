"""The valley of a fit: the paper's loss over every pair of macro variables, and the draws of all parameters.

The grid places every press by its normalised image. By default the valley is bounded by another likelihood, that of
the absolute images, whose bound is not a level of this loss and is not drawn here. The loss of the grid at the best
point is drawn.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from skincal.fitting.fit_options import PAPER_BOUND_COUNTS2
from skincal.fitting.result import FitResult
from skincal.fitting.types import Floats
from skincal.report import style
from skincal.report.fit import Quantity, quantities

COLOURS = "viridis_r"
"""Colour map that is yellow where the loss is low, so that black marks stand out."""

LEVELS = 16
MOST_DOTS = 400


@dataclass(frozen=True, eq=False)
class _Axis:
    """A macro variable of the grid: its quantity, its axis in the grid's arrays, and its values."""

    quantity: Quantity
    axis: int
    values: Floats


@style.styled
def valley_figure(result: FitResult) -> Figure:
    """Draw the evaluated grid with the meaningful levels of its loss, as a triangle of panels.

    The diagonal shows the loss along one macro variable, the panels below it the loss over a pair, each minimised over
    all other variables (and over the scale and every contact position). Variables that were not searched are left out.
    """
    rmse = np.sqrt(np.maximum(result.grid.mse_counts2, 1e-6))
    axes_of = _searched(result)
    # Levels of the contours, evenly spaced in the logarithm of the error [counts].
    low = float(rmse.min())
    levels = np.geomspace(low, max(float(np.quantile(rmse, 0.99)), 1.5 * low), LEVELS)
    count = len(axes_of)
    figure = style.new_figure(11, 11 if count == 4 else 8.5, "The paper's loss over the macro variables")
    if not count:
        return figure
    grid = figure.add_gridspec(count, count)
    for i, row in enumerate(axes_of):
        for j, col in enumerate(axes_of[: i + 1]):
            axes = figure.add_subplot(grid[i, j])
            if i == j:
                _draw_profile(axes, row, _least(rmse, row.axis), result)
            else:
                _draw_pair(axes, col, row, _least(rmse, col.axis, row.axis), levels, result)
            y_label = "rmse [counts]" if i == j else row.quantity.axis_label
            x_label = col.quantity.axis_label
            _label_panel(axes, x_label, y_label, bottom=i == count - 1, left=j == 0 or i == j)
    _explain(figure, grid, levels, result)
    return figure


def _label_panel(axes: Axes, x_label: str, y_label: str, *, bottom: bool, left: bool) -> None:
    """Label a panel of a triangle: x in the lowest row, y in the first column."""
    if bottom:
        axes.set_xlabel(x_label)
    else:
        axes.tick_params(labelbottom=False)
    if left:
        axes.set_ylabel(y_label)
    else:
        axes.tick_params(labelleft=False)


def _searched(result: FitResult) -> list[_Axis]:
    grid = result.grid.grid
    values = {
        "alpha_rad": (0, grid.alpha_rad),
        "elasticity_pa_per_m": (1, np.exp(grid.log_elasticity)),
        "across_m": (2, grid.across_m),
        "y_m": (3, grid.y_m),
    }
    own = [(q, *values[q.name]) for q in quantities(result) if q.name in values]
    return [_Axis(q, axis, points * q.factor) for q, axis, points in own if len(points) > 1]


def _least(rmse: Floats, *keep: int) -> Floats:
    """Return the smallest value over all axes except ``keep``, in the order of ``keep``."""
    others = tuple(axis for axis in range(rmse.ndim) if axis not in keep)
    least = rmse.min(axis=others)
    return least if keep == tuple(sorted(keep)) else least.T


def _marks(result: FitResult) -> list[tuple[float, str, Any, str]]:
    paper = PAPER_BOUND_COUNTS2**0.5
    if result.bound == "fixed":
        own, words = result.valley_mse_counts2**0.5, "valley's bound"
    else:
        own, words = result.grid.mse_at_best_counts2**0.5, "this loss at the best point"
    marks: list[tuple[float, str, Any, str]] = [(own, style.RED, "-", f"{words}, {own:.3g} counts")]
    if abs(own - paper) > 1e-9:
        marks.append((paper, style.BLACK, "--", f"bound of the paper, {paper:g} counts"))
    return marks


def _draw_profile(axes: Axes, of: _Axis, least: Floats, result: FitResult) -> None:
    axes.plot(of.values, least, color=style.BLUE, marker=".", markersize=3)
    for value, colour, line, _ in _marks(result):
        axes.axhline(value, color=colour, linestyle=line, linewidth=1.0)
    if of.quantity.identified:
        axes.axvspan(of.quantity.low, of.quantity.high, color=style.ORANGE, alpha=0.35, linewidth=0)
    axes.axvline(of.quantity.best, color=style.BLACK, linewidth=0.8)
    style.log_scale(axes, "y")
    axes.margins(x=0.0)
    if of.quantity.logarithmic:
        style.log_scale(axes, "x")
    note = "" if of.quantity.identified else ": not identified"
    axes.set_title(f"along {of.quantity.label}{note}", fontsize=9)


def _draw_pair(axes: Axes, col: _Axis, row: _Axis, least: Floats, levels: Floats, result: FitResult) -> None:
    """Draw the error over two macro variables; ``least`` is (values of col, values of row)."""
    norm, place = LogNorm(levels[0], levels[-1]), (col.values, row.values, least.T)
    axes.contourf(*place, levels=levels, cmap=COLOURS, norm=norm, extend="both")
    for value, colour, line, _ in _marks(result):
        if least.min() < value < least.max():
            axes.contour(*place, levels=[value], colors=[colour], linestyles=[line], linewidths=1.3)
    x, y = col.quantity, row.quantity
    dots = slice(None, None, max(1, len(result.draws) // MOST_DOTS))
    axes.plot(x.draws[dots], y.draws[dots], ".", color=style.BLACK, markersize=2, markeredgewidth=0)
    axes.plot(x.best, y.best, "o", markersize=10, **style.OPEN)
    axes.set(xlim=col.values[[0, -1]], ylim=row.values[[0, -1]])
    for quantity, along in ((x, "x"), (y, "y")):
        if quantity.logarithmic:
            style.log_scale(axes, along)


def _explain(figure: Figure, grid: GridSpec, levels: Floats, result: FitResult) -> None:
    """Draw legend and colour bar in the upper right, where the triangle leaves room."""
    side = grid.ncols
    place = figure.add_subplot(grid[0, side // 2 :])
    place.set_axis_off()
    handles: list[Any] = [
        Line2D([], [], color=colour, linestyle=line, label=words) for _, colour, line, words in _marks(result)
    ]
    handles += [
        Line2D([], [], linestyle="", marker="o", markersize=9, label="best point", **style.OPEN),
        Line2D([], [], linestyle="", marker=".", color=style.BLACK, label="draws from the valley"),
    ]
    if any(of.quantity.identified for of in _searched(result)):
        handles.append(Patch(color=style.ORANGE, alpha=0.35, label="interval"))
    place.legend(handles=handles, loc="upper right", fontsize=9)
    if side < 2:
        return
    bar_place = place.inset_axes((0.1, 0.2, 0.9, 0.08))
    mappable = ScalarMappable(LogNorm(levels[0], levels[-1]), COLOURS)
    bar = figure.colorbar(mappable, cax=bar_place, orientation="horizontal", extend="both")
    bar.set_label("rmse per taxel [counts], minimum over the other variables", fontsize=8)
    style.few_logarithmic_ticks(bar.ax.xaxis)


BINS = 40
MOST_PAIRS = 1500


@style.styled
def draws_figure(result: FitResult) -> Figure:
    """Draw each parameter on the diagonal, pairs of them below it and their correlations above it."""
    all_of = quantities(result)
    count = len(all_of)
    figure = style.new_figure(11, 10.5, f"Draws from the valley ({len(result.draws)})")
    grid = figure.add_gridspec(count, count)
    for i, row in enumerate(all_of):
        for j, col in enumerate(all_of):
            axes = figure.add_subplot(grid[i, j])
            if j > i:
                _write_correlation(axes, row.draws, col.draws)
                continue
            if i == j:
                _draw_alone(axes, col)
            else:
                _draw_dots(axes, col, row)
                _few_ticks(axes, "y", row)
            _few_ticks(axes, "x", col)
            _label_panel(axes, col.axis_label, row.axis_label, bottom=i == count - 1, left=j == 0 and i > 0)
    interval = Line2D([], [], color=style.ORANGE, label="interval")
    handles = [
        Line2D([], [], color=style.RED, label="best"),
        *([interval] if any(q.identified for q in all_of) else []),
        Line2D([], [], color=style.GREY, linestyle=":", label="searched range"),
        Patch(facecolor="#C6DAE8", label="correlation"),
    ]
    figure.legend(handles=handles, loc="outside upper right", ncols=len(handles))
    return figure


def _draw_alone(axes: Axes, of: Quantity) -> None:
    axes.hist(of.draws, bins=_bins(of), histtype="stepfilled", color=style.BLUE)  # type: ignore[arg-type]
    _mark(axes.axvline, of)
    axes.axvline(of.best, color=style.RED, linewidth=1.2)
    title = f"{of.label} {of.best_text}" if of.identified else f"{of.label}: not identified"
    axes.set_title(title, fontsize=9)
    axes.set_yticks([])
    axes.spines["left"].set_visible(False)
    axes.set_xlim(*_limits(of))


def _bins(of: Quantity) -> Floats:
    """Return the edges of the bars; draws from a grid have few values, and each gets one bar."""
    different = np.unique(of.draws)
    if 1 < len(different) < BINS:
        middle = (different[1:] + different[:-1]) / 2
        return np.concatenate([[2 * different[0] - middle[0]], middle, [2 * different[-1] - middle[-1]]])
    spaced = np.geomspace if _spans_decades(of, *_limits(of)) else np.linspace
    return spaced(*_limits(of), BINS + 1)


def _draw_dots(axes: Axes, col: Quantity, row: Quantity) -> None:
    dots = slice(None, None, max(1, len(col.draws) // MOST_PAIRS))
    axes.plot(
        col.draws[dots], row.draws[dots], ".", color=style.BLUE, alpha=0.35, markersize=3, markeredgewidth=0
    )
    _mark(axes.axvline, col)
    _mark(axes.axhline, row)
    axes.plot(col.best, row.best, "o", markersize=8, **style.OPEN)
    axes.set(xlim=_limits(col), ylim=_limits(row))


def _mark(line: Any, of: Quantity) -> None:
    """Mark the ends of the interval, and those of the searched range where they are in sight."""
    for end in (of.low, of.high) if of.identified else ():
        line(end, color=style.ORANGE, linewidth=1.2)
    low, high = _limits(of)
    for end in of.searched or ():
        if low < end < high:
            line(end, color=style.GREY, linewidth=1.0, linestyle=":")


def _limits(of: Quantity) -> tuple[float, float]:
    """Return limits that contain all draws, the best value and the interval, with a margin."""
    low, high = min(float(of.draws.min()), of.best), max(float(of.draws.max()), of.best)
    if of.identified:
        low, high = min(low, of.low), max(high, of.high)
    if _spans_decades(of, low, high):
        return low * (low / high) ** 0.05, high * (high / low) ** 0.05
    margin = 0.05 * (high - low) or 0.01 * abs(high) or 1.0
    return low - margin, high + margin


def _spans_decades(of: Quantity, low: float, high: float) -> bool:
    """Return whether E spans so wide a range that it is drawn on a logarithmic axis."""
    return of.logarithmic and low > 0 and high > 3 * low


def _write_correlation(axes: Axes, one: Floats, other: Floats) -> None:
    axes.set_axis_off()
    if np.ptp(one) == 0 or np.ptp(other) == 0:
        return
    value = round(float(np.corrcoef(one, other)[0, 1]), 2) + 0.0
    axes.imshow([[value]], cmap=style.DIVERGING, vmin=-1.6, vmax=1.6, aspect="auto")
    text = f"{value:.2f}".replace("-", "−")
    axes.text(0, 0, text, ha="center", va="center", fontsize=9 + 5 * abs(value))


def _few_ticks(axes: Axes, along: str, of: Quantity) -> None:
    if _spans_decades(of, *_limits(of)):
        style.log_scale(axes, along)
    else:
        axis = axes.xaxis if along == "x" else axes.yaxis
        axis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10], prune="both"))
