"""The figure of a policy's run on a hand: the object's path, the force, and the policy's period."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from skincal.deploy import Deployed
from skincal.model import TaxelLayout
from skincal.report.eval_marble import draw_layout
from skincal.report.style import BLACK, BLUE, GREY, RED, new_figure, style


def deploy_figure(found: Deployed, layout: TaxelLayout, title: str = "") -> Figure:
    """Draw the desired and true path over the taxels, the normal force over time, and the policy's period.

    Args:
        found: record of the run.
        layout: layout of the taxels.
        title: title of the figure.
    """
    with style():
        figure = new_figure(10.0, 4.2, title)
        way, force, clock = figure.subplots(1, 3, width_ratios=(1.1, 1.0, 1.0))
        _draw_way(way, found, layout)
        _draw_force(force, found)
        _draw_clock(clock, found)
    return figure


def _draw_way(axes: Axes, found: Deployed, layout: TaxelLayout) -> None:
    draw_layout(axes, layout)
    targets, places = 1e3 * found.targets, 1e3 * found.record.places_m[found.record.acting :]
    if targets.shape[1] == 2:
        axes.plot(targets[:, 0], targets[:, 1], color=BLACK, linewidth=1.0, label="desired")
    if np.isfinite(places).any():
        axes.plot(places[:, 0], places[:, 1], color=RED, linewidth=1.0, label="true")
    else:
        axes.set_title("the hand does not measure the object's position")
    axes.set_aspect("equal", adjustable="box")
    axes.set_xlabel("u [mm]")
    axes.set_ylabel("v [mm]")
    axes.legend(loc="upper left", bbox_to_anchor=(0.0, -0.16), ncols=2, borderaxespad=0.0)


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
