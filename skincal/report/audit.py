"""The figure of an audit: the smallest visible strength of each effect, and the effects that look the same."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from skincal.diagnosis.audit import AuditReport
from skincal.report.style import BLACK, BLUE, GREY, RED, SEQUENTIAL, new_figure, styled

WEAKEST, STRONGEST = 1e-3, 30.0
"""Limits of the axis of strengths, at which bars end."""


@styled
def audit_figure(report: AuditReport) -> Figure:
    """Draw the smallest visible strengths as bars, and the matrix of cosines between effects."""
    what = "planned presses" if report.planned else "presses"
    title = f"{len(report.visible)} of {len(report.effects)} effects are visible in {report.presses} {what}"
    figure = new_figure(13.5, 6.6, title)
    bars, matrix = figure.subplots(1, 2, width_ratios=(1.0, 1.25))
    _draw_strengths(bars, report)
    _draw_overlaps(figure, matrix, report)
    return figure


def _draw_strengths(axes: Axes, report: AuditReport) -> None:
    place = np.arange(len(report.effects))
    smallest = np.array([effect.smallest_strength for effect in report.effects.values()])
    ends = np.clip(smallest, WEAKEST, STRONGEST)
    colours = [BLUE if name in report.visible else RED for name in report.effects]
    axes.set_xscale("log")
    axes.barh(place, 1 / ends, color=colours, height=0.7)
    axes.set_xlim(1 / STRONGEST, 1 / WEAKEST)
    axes.axvline(1.0, color=BLACK, linewidth=1)
    for k, value in enumerate(smallest):
        text = f"{value:.2g}" if value < STRONGEST else f"> {STRONGEST:g}" if np.isfinite(value) else "never"
        point = (max(1 / ends[k], 1.15 / STRONGEST), k)
        axes.annotate(text, point, (3, 0), textcoords="offset points", va="center", fontsize=7.5, color=BLACK)
    axes.set_yticks(place, list(report.effects))
    axes.invert_yaxis()
    axes.set_xlabel("typical strength over the smallest visible one; right of the line: visible")
    axes.set_title("Smallest visible strength (number)")
    axes.grid(axis="x")


def _draw_overlaps(figure: Figure, axes: Axes, report: AuditReport) -> None:
    names = list(report.effects)
    cosines = np.full((len(names), len(names)), np.nan)
    for i, effect in enumerate(report.effects.values()):
        if effect.distance > 0:
            cosines[i] = [effect.overlaps.get(other, np.nan) for other in names]
    shown = axes.imshow(cosines, vmin=0, vmax=1, cmap=SEQUENTIAL)
    for i, effect in enumerate(report.effects.values()):
        for other in effect.consistent_with[1:]:
            corner = (names.index(other) - 0.5, i - 0.5)
            axes.add_patch(Rectangle(corner, 1, 1, fill=False, edgecolor=RED, linewidth=1.8))
    axes.set_facecolor(GREY)
    axes.set_xticks(np.arange(len(names)), names, rotation=90)
    axes.set_yticks(np.arange(len(names)), names)
    axes.set_title(f"Similarity of the effects of column and row; red: cosine above {report.options.alike:g}")
    figure.colorbar(shown, ax=axes, shrink=0.8, label="cosine")
