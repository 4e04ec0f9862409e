"""The figure of a policy's run on a hand: the object's path, the force, and the policy's period."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from skincal.deploy import Deployed
from skincal.model import TaxelLayout
from skincal.report.eval_marble import draw_layout
from skincal.report.style import BLACK, BLUE, GREY, RED, new_figure, style

FloatArray = NDArray[np.float64]


def deploy_figure(
    found: Deployed, layout: TaxelLayout, title: str = "", *, felt_m: FloatArray | None = None
) -> Figure:
    """Draw desired and true way over the taxels, the normal force over time, and the policy's period.

    Args:
        found: of the run.
        layout: of the taxels.
        title: above it all.
        felt_m: (T, 2) where the object was by the tactile images, at every state [m].
    """
    with style():
        figure = new_figure(10.0, 4.2, title)
        way, force, clock = figure.subplots(1, 3, width_ratios=(1.1, 1.0, 1.0))
        _draw_way(way, found, layout, felt_m)
        _draw_force(force, found)
        _draw_clock(clock, found)
    return figure


def _draw_way(axes: Axes, found: Deployed, layout: TaxelLayout, felt_m: FloatArray | None) -> None:
    draw_layout(axes, layout)
    targets, places = 1e3 * found.targets, 1e3 * found.record.places_m[found.record.acting :]
    if targets.shape[1] == 2:
        axes.plot(targets[:, 0], targets[:, 1], color=BLACK, linewidth=1.0, label="desired")
    if felt_m is not None:
        acting = np.array([phase == "acting" for phase in found.record.phases])
        felt = 1e3 * felt_m[acting]
        axes.plot(felt[:, 0], felt[:, 1], color=BLUE, linewidth=0.8, label="estimated")
    if np.isfinite(places).any():
        axes.plot(places[:, 0], places[:, 1], color=RED, linewidth=1.0, label="true")
    else:
        axes.set_title("the hand does not measure the object's position")
    axes.set_aspect("equal", adjustable="box")
    axes.set_xlabel("u [mm]")
    axes.set_ylabel("v [mm]")
    axes.legend(loc="upper left", bbox_to_anchor=(0.0, -0.16), ncols=3, borderaxespad=0.0)


def _draw_force(axes: Axes, found: Deployed) -> None:
    record = found.record
    time_s = np.array([state.time_s for state in record.states])
    axes.plot(time_s - time_s[record.acting], record.force_n, color=BLUE, linewidth=0.8)
    axes.axvline(0.0, color=GREY, linewidth=0.8)
    axes.set_xlabel("time [s]; the policy starts at 0")
    axes.set_ylabel("normal force from the joints [N]")


def _draw_clock(axes: Axes, found: Deployed) -> None:
    axes.plot(1e3 * found.period_s, color=BLUE, linewidth=0.8, label="hand's clock")
    axes.plot(1e3 * found.own_period_s, color=GREY, linewidth=0.8, label="this computer's")
    axes.set_xlabel("policy step")
    axes.set_ylabel("time since the previous step [ms]")
    axes.set_ylim(bottom=0.0)
    axes.legend(loc="upper left", bbox_to_anchor=(0.0, -0.16), ncols=2, borderaxespad=0.0)
