"""The slack of a fit: the measured positions of the presses, and those estimated from their images."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Polygon, Rectangle
from numpy.typing import NDArray

from skincal.dataset import Dataset
from skincal.fitting.result import FitResult
from skincal.model import TaxelLayout
from skincal.report.fit_presses import PressView
from skincal.report.labels import name_points
from skincal.report.style import (
    BLACK,
    BLUE,
    GREY,
    LIGHT,
    ORANGE,
    RED,
    equal_axes_mm,
    new_figure,
    style,
)  # fmt: skip

FloatArray = NDArray[np.floating[Any]]

MOST_NAMED = 40
"""Up to this number, presses are labelled with their numbers where there is room."""


def slack_figure(result: FitResult, dataset: Dataset) -> Figure:
    """Draw the slack of every press: on the patch, and all slacks from one point.

    Args:
        result: a fit.
        dataset: the dataset that was fitted.

    Returns:
        A figure with two panels.
    """
    view = PressView.of(result, dataset)
    with style():
        figure = new_figure(11, 6.4, "Contact positions: measured, and estimated within their slack")
        grid = figure.add_gridspec(1, 2, width_ratios=(1.25, 1))
        patch, slack = (figure.add_subplot(place) for place in grid)
        _draw_patch(patch, result, view)
        _draw_slack(slack, result, view)
        if len(view.used) <= MOST_NAMED:
            _name_presses(figure, patch, slack, result, view)
    return figure


def _name_presses(figure: Figure, patch: Axes, slack: Axes, result: FitResult, view: PressView) -> None:
    """Write the numbers of the presses on both panels where there is room; both must have been laid out before."""
    figure.draw_without_rendering()
    names = [str(number) for number in view.press[view.used]]
    start, end = 1e3 * view.measured_uv_m[view.used], 1e3 * view.estimated_uv_m
    on_lines = np.concatenate([start + part * (end - start) for part in np.linspace(0.0, 0.9, 8)])
    others = _near(1e3 * view.measured_uv_m[view.unused], 1e3 * result.problem.rig.layout.bounds_m)
    missing = name_points(patch, names, end, keep_clear=np.concatenate([on_lines, others]))
    _say_missing(patch, missing)
    moved = 1e3 * result.presses.slack_m
    _say_missing(slack, name_points(slack, names, moved, keep_clear=moved.mean(axis=0, keepdims=True)))


def _say_missing(axes: Axes, missing: int) -> None:
    if missing:
        words = f"{missing} number{'s' if missing > 1 else ''} left out for lack of room"
        axes.text(1.0, 1.0, words, transform=axes.transAxes, ha="right", va="bottom", fontsize=7, color=GREY)


def draw_taxels(axes: Axes, layout: TaxelLayout) -> None:
    """Draw the taxels as grey rectangles on axes over (u, v) in millimetres."""
    for centre, size in zip(1e3 * layout.centres_m, 1e3 * layout.sizes_m, strict=True):
        corner = (float(centre[0] - size[0] / 2), float(centre[1] - size[1] / 2))
        axes.add_patch(Rectangle(corner, *size, facecolor=LIGHT, edgecolor=GREY, linewidth=0.6))


def _draw_patch(axes: Axes, result: FitResult, view: PressView) -> None:
    layout = result.problem.rig.layout
    draw_taxels(axes, layout)
    measured = 1e3 * view.measured_uv_m[view.used]
    estimated = 1e3 * view.estimated_uv_m
    good = result.presses.good
    axes.add_collection(
        LineCollection(list(np.stack([measured, estimated], axis=1)), colors=RED, linewidths=0.9)
    )
    axes.plot(*measured.T, "o", color=BLACK, markersize=3)
    axes.plot(*estimated[good].T, "o", color=RED, markersize=3)
    look: Any = {"markerfacecolor": "white", "markeredgecolor": RED, "markeredgewidth": 1.3}
    axes.plot(*estimated[~good].T, "D", markersize=6, **look)
    others = _near(1e3 * view.measured_uv_m[view.unused], 1e3 * layout.bounds_m)
    axes.plot(*others.T, "x", color=GREY, markersize=4, markeredgewidth=0.9)
    box = _draw_box(axes, result, measured)
    equal_axes_mm(axes, "u", "v")
    axes.set_title("On the patch", pad=6)
    handles = [
        Line2D([], [], linestyle="", marker="o", markersize=4, color=BLACK, label="measured"),
        Line2D([], [], linestyle="-", marker="o", markersize=4, color=RED, label="estimated"),
    ]
    if not good.all():
        handles.append(Line2D([], [], linestyle="", marker="D", label="matches badly", **look))
    if len(others):
        handles.append(Line2D([], [], linestyle="", marker="x", color=GREY, label="not used"))
    if box:
        handles.append(Line2D([], [], color=BLUE, linestyle="--", label="slack of one press"))
    _legend_below(axes, handles, 3)


def _draw_box(axes: Axes, result: FitResult, measured: FloatArray) -> bool:
    """Draw the slack's square around the most moved press, across and along the finger; return whether it was drawn."""
    slack, alpha = 1e3 * result.problem.rig.slack_m, result.best["alpha_rad"]
    if not np.isfinite(slack):
        return False
    moved = int(np.argmax(np.hypot(*result.presses.slack_m.T)))
    corners = slack * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    cos, sin = np.cos(alpha), np.sin(alpha)
    turned = corners @ np.array([[cos, -sin], [sin, cos]])
    axes.add_patch(
        Polygon(measured[moved] + turned, fill=False, edgecolor=BLUE, linestyle="--", linewidth=1.0)
    )
    return True


def _draw_slack(axes: Axes, result: FitResult, view: PressView) -> None:
    slack, good = 1e3 * result.presses.slack_m, result.presses.good
    rig, found = result.problem.rig, 1e3 * result.sigmas.position_m
    axes.axhline(0, color=LIGHT)
    axes.axvline(0, color=LIGHT)
    handles: list[Any] = []
    if np.isfinite(rig.slack_m):
        half = 1e3 * rig.slack_m
        axes.add_patch(
            Rectangle((-half, -half), 2 * half, 2 * half, fill=False, edgecolor=BLUE, linestyle="--")
        )
        handles.append(Line2D([], [], color=BLUE, linestyle="--", label=f"slack, ±{half:g} mm"))
    if np.isfinite(rig.position_sigma_m):
        declared = 1e3 * rig.position_sigma_m
        axes.add_patch(Circle((0, 0), 2 * declared, fill=False, edgecolor=GREY))
        handles.append(Line2D([], [], color=GREY, label=f"declared: 2 sigma, 2 × {declared:.2g} mm"))
    axes.add_patch(Circle((0, 0), 2 * found, fill=False, edgecolor=ORANGE))
    handles.append(Line2D([], [], color=ORANGE, label=f"estimated: 2 sigma, 2 × {found:.2g} mm"))
    axes.plot(*slack[good].T, "o", color=RED, markersize=4)
    look: Any = {"markerfacecolor": "white", "markeredgecolor": RED, "markeredgewidth": 1.3}
    axes.plot(*slack[~good].T, "D", markersize=6, **look)
    mean = np.round(slack.mean(axis=0), 2) + 0.0
    axes.plot(*mean, "+", color=BLACK, markersize=11, markeredgewidth=1.8)
    words = f"mean ({mean[0]:.2f}, {mean[1]:.2f}) mm".replace("-", "−")
    handles.append(Line2D([], [], linestyle="", marker="+", markersize=9, color=BLACK, label=words))
    equal_axes_mm(axes, "estimated − measured, across", "estimated − measured, along y")
    axes.set_title("Slack of the presses used", pad=6)
    _legend_below(axes, handles, 2)


def _near(uv: FloatArray, bounds: FloatArray) -> FloatArray:
    """Return which points lie within a patch's size of the patch; a stray press must not shrink the others."""
    size = float(np.ptp(bounds, axis=0).max())
    return uv[(np.abs(uv - bounds.mean(axis=0)) <= 1.5 * size).all(axis=1)]


def _legend_below(axes: Axes, handles: list[Any], columns: int) -> None:
    place: Any = {"loc": "upper left", "bbox_to_anchor": (0.0, -0.1), "borderaxespad": 0.0}
    axes.legend(handles=handles, ncols=columns, columnspacing=1.2, **place)
