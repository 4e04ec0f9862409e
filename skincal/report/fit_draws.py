"""The draws from a fit's valley: every parameter, and every pair of parameters, with the intervals."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from skincal.fitting.result import FitResult
from skincal.fitting.types import Floats
from skincal.report.fit_quantities import Quantity, label_panel, quantities
from skincal.report.style import BLUE, DIVERGING, GREY, OPEN, ORANGE, RED, log_scale, new_figure, styled

BINS = 40
MOST_DOTS = 1500


@styled
def draws_figure(result: FitResult) -> Figure:
    """Draw each parameter on the diagonal, pairs of them below it and their correlations above it."""
    all_of = quantities(result)
    count = len(all_of)
    figure = new_figure(11, 10.5, f"Draws from the valley ({len(result.draws)})")
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
                _draw_pair(axes, col, row)
                _few_ticks(axes, "y", row)
            _few_ticks(axes, "x", col)
            label_panel(axes, col.axis_label, row.axis_label, bottom=i == count - 1, left=j == 0 and i > 0)
    interval = Line2D([], [], color=ORANGE, label="interval")
    handles = [
        Line2D([], [], color=RED, label="best"),
        *([interval] if any(q.identified for q in all_of) else []),
        Line2D([], [], color=GREY, linestyle=":", label="searched range"),
        Patch(facecolor="#C6DAE8", label="correlation"),
    ]
    figure.legend(handles=handles, loc="outside upper right", ncols=len(handles))
    return figure


def _draw_alone(axes: Axes, of: Quantity) -> None:
    axes.hist(of.draws, bins=_bins(of), histtype="stepfilled", color=BLUE)  # type: ignore[arg-type]
    _mark(axes.axvline, of)
    axes.axvline(of.best, color=RED, linewidth=1.2)
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


def _draw_pair(axes: Axes, col: Quantity, row: Quantity) -> None:
    dots = slice(None, None, max(1, len(col.draws) // MOST_DOTS))
    axes.plot(col.draws[dots], row.draws[dots], ".", color=BLUE, alpha=0.35, markersize=3, markeredgewidth=0)
    _mark(axes.axvline, col)
    _mark(axes.axhline, row)
    axes.plot(col.best, row.best, "o", markersize=8, **OPEN)
    axes.set(xlim=_limits(col), ylim=_limits(row))


def _mark(line: Any, of: Quantity) -> None:
    """Mark the ends of the interval, and those of the searched range where they are in sight."""
    for end in (of.low, of.high) if of.identified else ():
        line(end, color=ORANGE, linewidth=1.2)
    low, high = _limits(of)
    for end in of.searched or ():
        if low < end < high:
            line(end, color=GREY, linewidth=1.0, linestyle=":")


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
    axes.imshow([[value]], cmap=DIVERGING, vmin=-1.6, vmax=1.6, aspect="auto")
    text = f"{value:.2f}".replace("-", "−")
    axes.text(0, 0, text, ha="center", va="center", fontsize=9 + 5 * abs(value))


def _few_ticks(axes: Axes, along: str, of: Quantity) -> None:
    if _spans_decades(of, *_limits(of)):
        log_scale(axes, along)
    else:
        axis = axes.xaxis if along == "x" else axes.yaxis
        axis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10], prune="both"))
