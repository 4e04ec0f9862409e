"""Figures of what a hand does: the presses of a plan, and the run of a policy."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from skincal.collect import KINDS, Mount, Plan
from skincal.model.arrays import FloatArray
from skincal.report import style

if TYPE_CHECKING:
    from skincal.deploy import Deployed
    from skincal.model import TaxelLayout

COLOURS = dict(zip(KINDS, (style.BLUE, style.RED, style.GREEN, style.ORANGE), strict=True))
LARGEST_MARK_PT2 = 110.0
MARKERS = {"o": "circles", "s": "squares", "D": "diamonds", "^": "triangles up", "v": "triangles down"}


@style.styled
def plan_figure(plan: Plan, mount: Mount) -> Figure:
    """Draw the sites of a plan on the patch at its nominal pose, and the forces over the order of the presses."""
    figure = style.new_figure(11.5, 5.2, f"{plan.name}: {len(plan)} presses")
    sites, order = figure.subplots(1, 2, width_ratios=(1.0, 1.3))
    _draw_sites(sites, plan, mount)
    _draw_order(order, plan)
    return figure


def _draw_sites(axes: Axes, plan: Plan, mount: Mount) -> None:
    style.draw_outlines(axes, mount.layout)
    uv = 1e3 * plan.sites_m()
    force = np.array([press.force_n for press in plan.presses])
    look: Any = {"edgecolors": style.BLACK, "linewidths": 0.4, "alpha": 0.75}
    for kind in KINDS:
        rows = np.array([press.kind == kind for press in plan.presses])
        if rows.any():
            area = np.clip(LARGEST_MARK_PT2 * force[rows] / force.max(), 5, None)
            axes.scatter(*uv[rows].T, s=area, color=COLOURS[kind], label=f"{kind} ({rows.sum()})", **look)
    axes.update_datalim(1e3 * mount.layout.bounds_m)
    axes.autoscale_view()
    style.equal_axes_mm(axes, "u", "v")
    axes.set_title("Sites on the patch, at its nominal pose; area: force")
    style.legend_below(axes, len(KINDS), 0.12)


def _draw_order(axes: Axes, plan: Plan) -> None:
    number = np.arange(len(plan))
    force = np.array([press.force_n for press in plan.presses])
    speeds = sorted({press.speed_m_per_s for press in plan.presses})
    for kind in KINDS:
        for speed, marker in zip(speeds, [*MARKERS] * len(speeds), strict=False):
            rows = np.array([p.kind == kind and p.speed_m_per_s == speed for p in plan.presses])
            axes.plot(number[rows], force[rows], marker, color=COLOURS[kind], markersize=4)
    _draw_poses(axes, plan)
    shapes = zip(speeds, MARKERS.values(), strict=False)
    axes.set_title("Order; " + ", ".join(f"{mark}: {1e3 * speed:g} mm/s" for speed, mark in shapes))
    axes.set(xlabel="press", ylabel="force [N]")
    axes.set_ylim(bottom=0)
    axes.grid(axis="y")


def _draw_poses(axes: Axes, plan: Plan) -> None:
    names = plan.pose_names
    for i, press in enumerate(plan.presses):
        if names.index(press.pose) % 2:
            axes.axvspan(i - 0.5, i + 0.5, color=style.LIGHT, linewidth=0, zorder=0)
    if len(names) > 1:
        text = style.as_it_is(f"white: pose {', '.join(names[::2])}; grey: pose {', '.join(names[1::2])}")
        axes.annotate(text, (1, 1), (0, 4), "axes fraction", "offset points", ha="right", fontsize=8)


@style.styled
def deploy_figure(found: Deployed, layout: TaxelLayout, *, felt_m: FloatArray | None = None) -> Figure:
    """Draw desired and true path over the taxels, the normal force over time, and the policy's period.

    ``felt_m`` (T, 2) is the position of the object as estimated from the tactile images, at every state [m].
    """
    figure = style.new_figure(10.0, 4.2)
    way, force, clock = figure.subplots(1, 3, width_ratios=(1.1, 1.0, 1.0))
    _draw_path(way, found, layout, felt_m)
    record = found.record
    time_s = np.array([state.time_s for state in record.states])
    force.plot(time_s - time_s[record.acting], record.grip_n, color=style.BLUE, linewidth=0.8)
    force.axvline(0.0, color=style.GREY, linewidth=0.8)
    force.set(xlabel="time [s]; the policy starts at 0", ylabel="normal force from the joints [N]")
    clock.plot(1e3 * found.period_s, color=style.BLUE, linewidth=0.8, label="hand's clock")
    clock.plot(1e3 * found.own_period_s, color=style.GREY, linewidth=0.8, label="this computer's")
    clock.set(xlabel="policy step", ylabel="time since the previous step [ms]")
    clock.set_ylim(bottom=0.0)
    style.legend_below(clock, 2, 0.16)
    return figure


def _draw_path(axes: Axes, found: Deployed, layout: TaxelLayout, felt_m: FloatArray | None) -> None:
    style.draw_outlines(axes, layout, "none")
    targets, places = 1e3 * found.targets, 1e3 * found.record.places_m[found.record.acting :]
    if targets.shape[1] == 2:
        axes.plot(*targets.T, color=style.BLACK, linewidth=1.0, label="desired")
    if felt_m is not None:
        acting = np.array([phase == "acting" for phase in found.record.phases])
        axes.plot(*(1e3 * felt_m[acting].T), color=style.BLUE, linewidth=0.8, label="estimated")
    if np.isfinite(places).any():
        axes.plot(places[:, 0], places[:, 1], color=style.RED, linewidth=1.0, label="true")
    else:
        axes.set_title("the hand does not measure the object's position")
    axes.set_aspect("equal", adjustable="box")
    axes.set(xlabel="u [mm]", ylabel="v [mm]")
    style.legend_below(axes, 3, 0.16)
