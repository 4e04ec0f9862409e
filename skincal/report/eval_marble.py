"""The figures of an evaluation: exemplary runs and the tracking error over time, for all policies side by side."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from skincal.model import TaxelLayout
from skincal.report.style import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    RED,
    as_it_is,
    legend_below,
    new_figure,
    styled,
)
from skincal.report.taxel_map import draw_outlines
from skincal.train.scores import Runs, Score

EXAMPLES = 3
COLOURS = (BLUE, RED, GREEN, ORANGE, PURPLE, GREY)


@styled
def runs_figure(runs: Mapping[str, Runs], layout: TaxelLayout, title: str = "") -> Figure:
    """Draw three runs of each policy by name, over the taxels and the target's path."""
    figure = new_figure(3.4 * len(runs) + 0.6, 4.2, title)
    all_axes = figure.subplots(1, len(runs), sharex=True, sharey=True, squeeze=False)[0]
    for axes, (name, some) in zip(all_axes, runs.items(), strict=True):
        draw_outlines(axes, layout, "none")
        _draw_runs(axes, some)
        axes.set_title(as_it_is(name))
        axes.set_aspect("equal", adjustable="box")
        axes.set_xlabel("u [mm]")
    all_axes[0].set_ylabel("v [mm]")
    legend_below(all_axes[0], 4, 0.16)
    return figure


@styled
def error_figure(scores: Mapping[str, Score], title: str = "") -> Figure:
    """Draw the mean tracking error over time with its 95 % interval, and the number of runs that last."""
    figure = new_figure(6.4, 3.8, title)
    axes = figure.subplots()
    for (name, score), colour in zip(scores.items(), COLOURS * len(scores), strict=False):
        label = f"{as_it_is(name)} ({score.episodes - score.drops} of {score.episodes} held)"
        axes.plot(score.time_s, 1e3 * score.error_m, color=colour, label=label)
        low, high = 1e3 * score.error_low_m, 1e3 * score.error_high_m
        axes.fill_between(score.time_s, low, high, color=colour, alpha=0.2, linewidth=0)
    axes.set_xlabel("time [s]")
    axes.set_ylabel("tracking error [mm]")
    # Leave room above the curves for one line of the legend each.
    axes.set_ylim(0, axes.get_ylim()[1] * (1 + 0.09 * len(scores)))
    axes.set_xlim(left=0)
    axes.grid(axis="y")
    axes.legend(loc="upper left")
    return figure


def _draw_runs(axes: Axes, runs: Runs) -> None:
    """Draw the first runs, which are not selected."""
    axes.plot(*(1e3 * runs.target_m[0].T), color=BLACK, linewidth=1.0, label="target")
    for i, colour in zip(range(min(EXAMPLES, len(runs))), (BLUE, ORANGE, GREEN), strict=False):
        way = 1e3 * runs.object_m[i]
        axes.plot(*way.T, color=colour, linewidth=1.2, label=f"run {i + 1}")
        held = np.isfinite(way).all(axis=1)
        if runs.dropped[i] and held.any():
            axes.plot(*way[held][-1], "x", color=colour, markersize=6)
