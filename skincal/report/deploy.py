"""The figure of a policy's run on a hand: the object's path, the force, and the policy's period."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from skincal.deploy import Deployed
from skincal.model import TaxelLayout
from skincal.model.arrays import FloatArray
from skincal.report.style import BLACK, BLUE, GREY, RED, draw_outlines, legend_below, new_figure, styled


@styled
def deploy_figure(found: Deployed, layout: TaxelLayout, *, felt_m: FloatArray | None = None) -> Figure:
    """Draw desired and true path over the taxels, the normal force over time, and the policy's period.

    ``felt_m`` (T, 2) is the position of the object as estimated from the tactile images, at every state [m].
    """
    figure = new_figure(10.0, 4.2)
    way, force, clock = figure.subplots(1, 3, width_ratios=(1.1, 1.0, 1.0))
    _draw_path(way, found, layout, felt_m)
    record = found.record
    time_s = np.array([state.time_s for state in record.states])
    force.plot(time_s - time_s[record.acting], record.grip_n, color=BLUE, linewidth=0.8)
    force.axvline(0.0, color=GREY, linewidth=0.8)
    force.set(xlabel="time [s]; the policy starts at 0", ylabel="normal force from the joints [N]")
    clock.plot(1e3 * found.period_s, color=BLUE, linewidth=0.8, label="hand's clock")
    clock.plot(1e3 * found.own_period_s, color=GREY, linewidth=0.8, label="this computer's")
    clock.set(xlabel="policy step", ylabel="time since the previous step [ms]")
    clock.set_ylim(bottom=0.0)
    legend_below(clock, 2, 0.16)
    return figure


def _draw_path(axes: Axes, found: Deployed, layout: TaxelLayout, felt_m: FloatArray | None) -> None:
    draw_outlines(axes, layout, "none")
    targets, places = 1e3 * found.targets, 1e3 * found.record.places_m[found.record.acting :]
    if targets.shape[1] == 2:
        axes.plot(*targets.T, color=BLACK, linewidth=1.0, label="desired")
    if felt_m is not None:
        acting = np.array([phase == "acting" for phase in found.record.phases])
        axes.plot(*(1e3 * felt_m[acting].T), color=BLUE, linewidth=0.8, label="estimated")
    if np.isfinite(places).any():
        axes.plot(places[:, 0], places[:, 1], color=RED, linewidth=1.0, label="true")
    else:
        axes.set_title("the hand does not measure the object's position")
    axes.set_aspect("equal", adjustable="box")
    axes.set(xlabel="u [mm]", ylabel="v [mm]")
    legend_below(axes, 3, 0.16)
