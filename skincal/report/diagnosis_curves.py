"""The winning signature before and after: what the base model leaves, and what is left with the named effects."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure, SubFigure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from skincal.model.arrays import FloatArray
from skincal.report.diagnosis_left import Left, Line, edges_of, left_by, line_of
from skincal.report.diagnosis_views import LEAST, OF_EFFECT, RINGS, VIEWS, Trace
from skincal.report.style import (
    BLACK,
    BLUE,
    DIVERGING,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    few_logarithmic_ticks,
    new_figure,
    style,
)
from skincal.report.taxel_map import draw_taxels

if TYPE_CHECKING:
    from skincal.diagnose.diagnosis import Diagnosis

COLOURS = (BLUE, ORANGE, GREEN, PURPLE)
MOST = 4
"""So many views at most."""

_FEW = 3
_STRONGEST = 2
"""Where nothing was named, so many of the views that explain most are shown."""


def views_of(found: Diagnosis, left: Left) -> tuple[Trace, ...]:
    """The views that show what was named; else those whose lines explain most of the residual.

    Args:
        found: a diagnosis.
        left: what the base model leaves.
    """
    # An effect that has no view of its own is shown by those that explain most.
    if own := dict.fromkeys(OF_EFFECT[e.name] for e in found.effects if e.name in OF_EFFECT):
        views = [VIEWS[name] for name in own]
        return tuple(v for v in views if v.kind == "moves" or len(_edges(v, left)) > 2)[:MOST]
    falls = {v.name: explained(v, left) for v in VIEWS.values() if v.kind != "moves"}
    chosen: list[Trace] = []
    for name in sorted(falls, key=lambda n: -falls[n]):
        seen_from = [(v.x_label, v.kind) for v in chosen]
        if falls[name] > -np.inf and (VIEWS[name].x_label, VIEWS[name].kind) not in seen_from:
            chosen.append(VIEWS[name])
    return tuple(chosen[:_STRONGEST])


def _edges(view: Trace, left: Left) -> FloatArray:
    """(B + 1,) edges of the bins of a view; none where the data do not have what it needs."""
    if view.kind == "categories":
        return np.arange(len(RINGS) + 1, dtype=np.float64) - 0.5
    if view.kind == "taxels":
        return np.arange(left.values.shape[1] + 1, dtype=np.float64) - 0.5
    return edges_of(view.parts(left), left, view.bins, log=view.log)


def explained(view: Trace, left: Left) -> float:
    """By how much the lines of a view lower the squared residual, less what as many lines do by chance."""
    edges = _edges(view, left)
    if len(edges) < 3:
        return float("-inf")
    lines = [line_of(part, left, edges, ~left.heldout) for part in view.parts(left)]
    falls = np.concatenate([line.fall for line in lines])
    return float(np.nansum(falls)) - float(np.isfinite(falls).sum())


def curves_figure(found: Diagnosis) -> Figure:
    """Draws the views in which an effect shows, before and, where effects were named, after.

    Args:
        found: a diagnosis.

    Returns:
        A figure with a row for each view, the base model on the left, the model with the named effects on the right;
        where nothing was named, the two views in which the base model leaves most.
    """
    before = left_by(found, found.choice.before)
    views = views_of(found, before)
    ends = [before, left_by(found, found.choice.after)] if found.effects else [before]
    rows = max(1, len(views) if found.effects else 1)
    with style():
        figure = new_figure(11.8, 3.7 * rows)
        grid = figure.add_gridspec(rows, 2)
        for k, view in enumerate(views):
            places = [grid[k, 0], grid[k, 1]] if found.effects else [grid[0, k]]
            axes = [figure.add_subplot(place) for place in places]
            _draw(figure, axes, view, ends)
            axes[0].set_title(view.title + (": base model" if found.effects else ""))
            if found.effects:
                axes[1].set_title(_with(found))
        if not views:
            figure.text(
                0.5, 0.5, "The data have no covariate against which the residual could be drawn.", ha="center"
            )
    return figure


def _with(found: Diagnosis) -> str:
    names = [e.name for e in found.effects]
    return "With " + " and ".join(names) if len(names) <= _FEW else "With all that was named"


def _draw(figure: Figure | SubFigure, axes: Sequence[Axes], view: Trace, ends: Sequence[Left]) -> None:
    if view.kind == "moves":
        _draw_moves(axes, ends)
        return
    edges = _edges(view, ends[0])
    fitted, kept = (
        [[line_of(p, left, edges, rows(left)) for p in view.parts(left)] for left in ends]
        for rows in (lambda left: ~left.heldout, lambda left: left.heldout)
    )
    if view.kind == "taxels":
        _draw_maps(figure, axes, view, ends, [lines[0] for lines in fitted])
        return
    for own, lines, held in zip(axes, fitted, kept, strict=True):
        own.axhline(0, color=BLACK, linewidth=0.9)
        for k, (line, other) in enumerate(zip(lines, held, strict=True)):
            _draw_line(own, view, line, other, COLOURS[k % len(COLOURS)])
        _label(own, view)
    _same_height(axes, view, [*fitted, *kept])
    _legend(axes[0], view, fitted[0])


def _draw_line(axes: Axes, view: Trace, line: Line, held: Line, colour: str) -> None:
    y, error = view.factor * line.y, 1.96 * view.factor * line.error
    if view.kind == "thin":
        axes.plot(line.x, y, color=BLUE, linewidth=0.9, alpha=0.8)
        return
    known = np.isfinite(y)
    joined = "none" if view.kind == "categories" else "-"
    axes.errorbar(line.x[known], y[known], error[known], color=colour, marker="o", markersize=4.5, linestyle=joined,
                  linewidth=1.4, elinewidth=1.0, capsize=0, label=line.label)  # fmt: skip
    shift = 0.16 if view.kind == "categories" else 0.0
    axes.plot(held.x + shift, view.factor * held.y, marker="D", markersize=5, linestyle="none",
              markerfacecolor="white", markeredgecolor=colour)  # fmt: skip


def _label(axes: Axes, view: Trace) -> None:
    axes.set(xlabel=view.x_label, ylabel=view.y_label)
    axes.grid(axis="y")
    if view.kind == "categories":
        axes.set_xticks(np.arange(len(RINGS)), RINGS)
        axes.set_xlim(-0.5, len(RINGS) - 0.5)
    elif view.name == "cycle":
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    elif view.log:
        axes.set_xscale("log")
        few_logarithmic_ticks(axes.xaxis)


def _same_height(axes: Sequence[Axes], view: Trace, lines: Sequence[Sequence[Line]]) -> None:
    """One scale before and after, so that what shrinks is seen to shrink."""
    ends = np.concatenate([
        view.factor * np.concatenate([line.y, line.y - 1.96 * line.error, line.y + 1.96 * line.error])
        for of_model in lines for line in of_model
    ])  # fmt: skip
    ends = ends[np.isfinite(ends)]
    if len(ends):
        least = LEAST.get(view.y_label, 0.0)
        low, high = min(float(ends.min()), -least), max(float(ends.max()), least)
        room = 0.08 * (high - low)
        for own in axes:
            own.set_ylim(low - room, high + room)


def _legend(axes: Axes, view: Trace, lines: Sequence[Line]) -> None:
    if view.kind == "thin":
        return
    drawn, words = axes.get_legend_handles_labels()
    named = dict(zip(words, drawn, strict=True))
    entries = [(named[line.label], line.label) for line in lines if line.label in named]
    if len(lines) == 1:
        entries = [(handle, "presses that were fitted") for handle, _ in entries]
    kept = Line2D([], [], marker="D", linestyle="none", color=GREY, markerfacecolor="white", markersize=5)
    entries.append((kept, "presses nobody fitted"))
    handles, labels = zip(*entries, strict=True)
    axes.legend(handles, labels, loc="upper left", bbox_to_anchor=(0.0, -0.16), ncols=4, borderaxespad=0.0)


def _draw_maps(
    figure: Figure | SubFigure,
    axes: Sequence[Axes],
    view: Trace,
    ends: Sequence[Left],
    lines: Sequence[Line],
) -> None:
    values = [view.factor * line.y for line in lines]
    known = np.concatenate(values)
    most = max(float(np.nanmax(np.abs(known), initial=0.0)), LEAST.get(view.y_label, 1e-3))
    norm = Normalize(-most, most)
    shown = [
        draw_taxels(own, left.layout, left.taxels, of, norm, DIVERGING)
        for own, left, of in zip(axes, ends, values, strict=True)
    ]
    figure.colorbar(shown[0], ax=list(axes), shrink=0.8, label=view.y_label)


def _draw_moves(axes: Sequence[Axes], ends: Sequence[Left]) -> None:
    most = 1.1 * max(float(np.abs(1e3 * left.places_m).max(initial=0.1)) for left in ends)
    for own, left in zip(axes, ends, strict=True):
        pose = _pose_of_presses(left)
        for k, number in enumerate(np.unique(pose).tolist()):
            moved = 1e3 * left.places_m[pose == number]
            word = "all presses" if number < 0 else f"hand pose {int(number) + 1}"
            own.plot(*moved.T, "o", color=COLOURS[k % len(COLOURS)], markersize=4, alpha=0.8, label=word)
        rms = 1e3 * float(np.sqrt((left.places_m**2).sum(axis=1).mean()))
        own.plot([], [], " ", label=f"rms {rms:.2f} mm")
        own.axhline(0, color=GREY, linewidth=0.8)
        own.axvline(0, color=GREY, linewidth=0.8)
        own.set(xlabel="moved across [mm]", ylabel="moved along [mm]", xlim=(-most, most), ylim=(-most, most))
        own.set_aspect("equal")
        own.legend(loc="upper right")


def _pose_of_presses(left: Left) -> FloatArray:
    pose = np.full(len(left.places_m), -1.0)
    touching = left.session.press >= 0
    known = np.nan_to_num(left.covariates.pose[touching], nan=-1.0)
    pose[left.session.press[touching]] = known
    return pose
