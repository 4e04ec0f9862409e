"""Where simulation and data disagree: squared residual beyond noise, by taxel and phase, and by force and phase."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from skincal.effects.samples import HOLD, IDLE, LOAD, UNLOAD
from skincal.model.arrays import BoolArray, FloatArray
from skincal.report.diagnosis_left import Left, left_by
from skincal.report.style import BLUE, GREY, ORANGE, few_logarithmic_ticks, new_figure, style
from skincal.report.taxel_map import draw_taxels

if TYPE_CHECKING:
    from skincal.diagnose.diagnosis import Diagnosis

PHASES = ((LOAD, "loading"), (HOLD, "hold"), (UNLOAD, "unloading"), (IDLE, "rest"))
_COLOURS = "YlOrRd"


def where_figure(found: Diagnosis) -> Figure:
    """Draws maps of the mean squared residual, in units of the noise, and what part of the excess lies where.

    Args:
        found: a diagnosis.

    Returns:
        A figure: a map for each phase, above of the base model, below with the named effects, and bars at the right.
    """
    ends = [("base model", left_by(found, found.choice.before))]
    if found.effects:
        ends.append(("with the effects", left_by(found, found.choice.after)))
    phases = [p for p in PHASES if (found.session.phase == p[0]).any()]
    maps = [[_by_taxel(left, left.session.phase == number) for number, _ in phases] for _, left in ends]
    top = max(3.0, float(np.nanmax(np.concatenate([m for row in maps for m in row]), initial=3.0)))
    with style():
        title = "Mean square of the residual, in units of the noise: 1 is noise alone"
        figure = new_figure(max(8.0, 3.0 + 2.2 * len(phases)), 0.9 + 2.05 * len(ends), title)
        grid = figure.add_gridspec(len(ends), len(phases) + 1, width_ratios=[1.0] * len(phases) + [1.25])
        norm = LogNorm(1.0, top, clip=True)
        axes = [[figure.add_subplot(grid[i, k]) for k in range(len(phases))] for i in range(len(ends))]
        for row, own, (words, left) in zip(axes, maps, ends, strict=True):
            for one, values, (_, phase) in zip(row, own, phases, strict=True):
                draw_taxels(one, left.layout, left.taxels, values, norm, _COLOURS)
                one.set_title(phase if row is axes[0] else "")
            row[0].set_ylabel(words)
        shown = ScalarMappable(norm, _COLOURS)
        bar = figure.colorbar(shown, ax=[one for row in axes for one in row], shrink=0.8, aspect=30)
        few_logarithmic_ticks(bar.ax.yaxis)
        bar.ax.yaxis.set_minor_locator(NullLocator())
        side = figure.add_subplot(grid[:, -1])
        if found.verdict == "none":
            _draw_words(side, "All in all no more than\nsessions leave in which\nnothing is hidden.")
        else:
            _draw_shares(side, ends, phases)
    return figure


def _by_taxel(left: Left, rows: BoolArray) -> FloatArray:
    """(J,) mean square of the whitened residual, NaN where nothing was read."""
    seen = (left.weight > 0) & rows[:, None]
    count = seen.sum(axis=0)
    total = np.where(seen, left.white**2, 0.0).sum(axis=0)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def excess(left: Left) -> FloatArray:
    """(N,) squared residual beyond noise of each observation, all taxels together."""
    seen = left.weight > 0
    return np.where(seen, left.white**2 - 1.0, 0.0).sum(axis=1)


def _draw_words(axes: Axes, words: str) -> None:
    axes.set_axis_off()
    axes.text(0.5, 0.5, words, ha="center", va="center", transform=axes.transAxes)


def _draw_shares(axes: Axes, ends: list[tuple[str, Left]], phases: list[tuple[int, str]]) -> None:
    """Where the excess lies: by phase, and within each phase below and above the middle force."""
    first = ends[0][1]
    whole = float(excess(first).sum())
    if whole <= 0:
        _draw_words(axes, "All in all no more\nthan noise makes.")
        return
    force = first.covariates.force_n
    middle = float(np.median(force[first.session.press >= 0]))
    labels: list[str] = []
    rows: list[BoolArray] = []
    for number, phase in phases:
        inside = first.session.phase == number
        if number == IDLE:
            labels.append("rest")
            rows.append(inside)
            continue
        for words, part in (
            (f"below {middle:.2g} N", force < middle),
            (f"above {middle:.2g} N", force >= middle),
        ):
            labels.append(f"{phase},\n{words}")
            rows.append(inside & part)
    place = np.arange(len(rows), dtype=np.float64)
    wide = 0.75 / len(ends)
    for k, (words, left) in enumerate(ends):
        share = [100 * float(excess(left)[own].sum()) / whole for own in rows]
        at = place + (k - (len(ends) - 1) / 2) * wide
        axes.barh(at, share, height=wide, color=(ORANGE, BLUE)[k], label=words)
    axes.axvline(0, color=GREY, linewidth=0.8)
    axes.set_yticks(place, labels)
    axes.invert_yaxis()
    axes.set_xlabel("% of the base model's excess")
    axes.grid(axis="x")
    if len(ends) > 1:
        axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=1, borderaxespad=0.1)
