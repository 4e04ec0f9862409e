"""The slack of a fit: the measured positions of the presses, and those estimated from their images."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Polygon, Rectangle

from skincal.dataset import Dataset
from skincal.dataset.placement import patch_coordinates
from skincal.fitting.result import FitResult
from skincal.fitting.types import Floats
from skincal.model import SensorPose
from skincal.report import style

MOST_NAMED = 40
"""Up to this number, presses are labelled with their numbers where there is room."""


@style.styled
def slack_figure(result: FitResult, dataset: Dataset) -> Figure:
    """Draw the slack of every press: on the patch, and all slacks from one point."""
    used, measured = result.problem.rows, 1e3 * measured_uv_m(result, dataset)
    estimated = 1e3 * result.presses.uv_m
    figure = style.new_figure(11, 6.4, "Contact positions: measured, and estimated within their slack")
    patch, slack = figure.subplots(1, 2, width_ratios=(1.25, 1))
    others = np.delete(measured, used, axis=0)
    others = others[style.near_patch(others, 1e3 * result.problem.rig.layout.bounds_m)]
    _draw_patch(patch, result, measured[used], estimated, others)
    _draw_slack(slack, result)
    if len(used) <= MOST_NAMED:
        style.lay_out(figure)  # labels need the places of the panels
        names = [str(number) for number in dataset.presses.press[used]]
        on_lines = [measured[used] + part * (estimated - measured[used]) for part in np.linspace(0.0, 0.9, 8)]
        _name_presses(patch, names, estimated, np.concatenate([*on_lines, others]))
        moved = 1e3 * result.presses.slack_m
        _name_presses(slack, names, moved, moved.mean(axis=0, keepdims=True))
    return figure


def measured_uv_m(result: FitResult, dataset: Dataset) -> Floats:
    """Return the measured contact positions (N, 2) on the patch at its best pose [m]; NaN where not measured."""
    rig, across_m = result.problem.rig, result.best["across_m"]
    radius_m = rig.arc_radius_m
    across = {"x_m": across_m} if radius_m is None else {"beta_rad": across_m / radius_m}
    pose = SensorPose(result.best["y_m"], result.best["alpha_rad"], **across)
    return patch_coordinates(rig.surface, pose, dataset.presses.position_m)


def _name_presses(axes: Axes, names: list[str], points: Floats, keep_clear: Floats) -> None:
    if missing := name_points(axes, names, points, keep_clear=keep_clear):
        words = f"{missing} number{'s' if missing > 1 else ''} left out for lack of room"
        axes.text(
            1.0, 1.0, words, transform=axes.transAxes, ha="right", va="bottom", fontsize=7, color=style.GREY
        )


def _draw_patch(axes: Axes, result: FitResult, measured: Floats, estimated: Floats, others: Floats) -> None:
    """Draw presses from measured to estimated position (K, 2), and the measured ones that were not used [mm]."""
    style.draw_outlines(axes, result.problem.rig.layout)
    good = result.presses.good
    lines = list(np.stack([measured, estimated], axis=1))
    axes.add_collection(LineCollection(lines, colors=style.RED, linewidths=0.9))
    axes.plot(*measured.T, "o", color=style.BLACK, markersize=3)
    axes.plot(*estimated[good].T, "o", color=style.RED, markersize=3)
    axes.plot(*estimated[~good].T, "D", markersize=6, **style.BAD)
    axes.plot(*others.T, "x", color=style.GREY, markersize=4, markeredgewidth=0.9)
    handles = [
        Line2D([], [], linestyle="", marker="o", markersize=4, color=style.BLACK, label="measured"),
        Line2D([], [], linestyle="-", marker="o", markersize=4, color=style.RED, label="estimated"),
    ]
    if not good.all():
        handles.append(Line2D([], [], linestyle="", marker="D", label="matches badly", **style.BAD))
    if len(others):
        handles.append(Line2D([], [], linestyle="", marker="x", color=style.GREY, label="not used"))
    slack, alpha = 1e3 * result.problem.rig.slack_m, result.best["alpha_rad"]
    if np.isfinite(slack):
        # The slack's square around the most moved press, across and along the finger.
        moved = int(np.argmax(np.hypot(*result.presses.slack_m.T)))
        cos, sin = np.cos(alpha), np.sin(alpha)
        corners = measured[moved] + slack * style.CORNERS @ np.array([[cos, -sin], [sin, cos]])
        axes.add_patch(Polygon(corners, fill=False, edgecolor=style.BLUE, linestyle="--", linewidth=1.0))
        handles.append(Line2D([], [], color=style.BLUE, linestyle="--", label="slack of one press"))
    style.equal_axes_mm(axes, "u", "v")
    axes.set_title("On the patch", pad=6)
    style.legend_below(axes, 3, handles=handles, columnspacing=1.2)


def _draw_slack(axes: Axes, result: FitResult) -> None:
    slack, good = 1e3 * result.presses.slack_m, result.presses.good
    rig, found = result.problem.rig, 1e3 * result.sigmas.position_m
    axes.axhline(0, color=style.LIGHT)
    axes.axvline(0, color=style.LIGHT)
    handles: list[Any] = []
    if np.isfinite(rig.slack_m):
        half = 1e3 * rig.slack_m
        box = Rectangle((-half, -half), 2 * half, 2 * half, fill=False, edgecolor=style.BLUE, linestyle="--")
        axes.add_patch(box)
        handles.append(Line2D([], [], color=style.BLUE, linestyle="--", label=f"slack, ±{half:g} mm"))
    circles = [("declared", 1e3 * rig.position_sigma_m, style.GREY), ("estimated", found, style.ORANGE)]
    for words, sigma, colour in circles:
        if np.isfinite(sigma):
            axes.add_patch(Circle((0, 0), 2 * sigma, fill=False, edgecolor=colour))
            handles.append(Line2D([], [], color=colour, label=f"{words}: 2 sigma, 2 × {sigma:.2g} mm"))
    axes.plot(*slack[good].T, "o", color=style.RED, markersize=4)
    axes.plot(*slack[~good].T, "D", markersize=6, **style.BAD)
    mean = np.round(slack.mean(axis=0), 2) + 0.0
    axes.plot(*mean, "+", color=style.BLACK, markersize=11, markeredgewidth=1.8)
    words = f"mean ({mean[0]:.2f}, {mean[1]:.2f}) mm".replace("-", "−")
    handles.append(Line2D([], [], linestyle="", marker="+", markersize=9, color=style.BLACK, label=words))
    style.equal_axes_mm(axes, "estimated − measured, across", "estimated − measured, along y")
    axes.set_title("Slack of the presses used", pad=6)
    style.legend_below(axes, 2, handles=handles, columnspacing=1.2)


SIZE_PT = 6.0

_WIDE, _HIGH = 0.62, 0.95
"""Width of a digit and height of a line, relative to the size of the letters."""

_DOT_PT = 2.5
_DISTANCES_PT = (3.0, 8.0, 14.0)
_FAR_PT = 5.0
"""Distance from which a thin line leads from the point to its label."""

_DIRECTIONS = np.radians([45, 315, 135, 225, 0, 180, 90, 270, 22, 338, 158, 202])


def name_points(axes: Axes, names: Sequence[str], points: Floats, *, keep_clear: Floats | None = None) -> int:
    """Write labels next to points (N, 2); return how many were left out for lack of room.

    The figure must have been laid out, so that the axes have their place and limits. No label covers the points or
    ``keep_clear`` (M, 2), both in the units of the axes.
    """
    at = _in_points(axes, points)
    dots = at if keep_clear is None else np.concatenate([at, _in_points(axes, keep_clear)])
    taken = np.concatenate([dots - _DOT_PT, dots + _DOT_PT], axis=1)
    left_out = 0
    for name, point, here in zip(names, points, at, strict=True):
        for offset, box in _candidates(here, name):
            apart = (box[:2] >= taken[:, 2:]) | (box[2:] <= taken[:, :2])
            if apart.any(axis=1).all():
                taken = np.concatenate([taken, box[None]])
                _write(axes, name, point, offset)
                break
        else:
            left_out += 1
    return left_out


def _in_points(axes: Axes, points: Floats) -> Floats:
    return axes.transData.transform(points) * 72.0 / axes.figure.dpi  # type: ignore[union-attr]


def _candidates(here: Floats, name: str) -> Iterator[tuple[Floats, Floats]]:
    """Yield candidate offsets of a label from its point, with the boxes (4,) it would fill [pt], the nearest first."""
    half = 0.5 * SIZE_PT * np.array([_WIDE * len(name), _HIGH])
    for distance in _DISTANCES_PT:
        for direction in _DIRECTIONS:
            towards = np.array([np.cos(direction), np.sin(direction)])
            offset = towards * (distance + half)
            yield offset, np.concatenate([here + offset - half, here + offset + half])


def _write(axes: Axes, name: str, point: Floats, offset: Floats) -> None:
    line: Any = {"arrowstyle": "-", "color": style.GREY, "linewidth": 0.4, "shrinkA": 0.0, "shrinkB": 2.0}
    far = float(np.abs(offset).max()) > _FAR_PT + 0.5 * SIZE_PT * _WIDE * len(name)
    look: Any = {
        "fontsize": SIZE_PT,
        "color": style.BLACK,
        "ha": "center",
        "va": "center",
        "in_layout": False,
    }
    places = tuple(point.tolist()), tuple(offset.tolist())
    axes.annotate(name, *places, textcoords="offset points", arrowprops=line if far else None, **look)
