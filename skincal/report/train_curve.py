"""The figure of learning curves: reward, tracking error and lost objects over environment steps."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from skincal.model.arrays import FloatArray
from skincal.report.style import SEVERAL, as_it_is, new_figure, styled

SMOOTH_STEPS = 10_000
"""Steps over which figures are averaged: a single round holds eight episodes."""


_PANELS = (
    ("reward", "reward of a step", 1.0),
    ("error_m", "tracking error [mm]", 1e3),
    ("drops", "episodes with a drop [%]", 1e2),
)


@styled
def curves_figure(curves: Mapping[str, Mapping[str, FloatArray]], title: str = "") -> Figure:
    """Draw learning curves: columns of each run by name (see :func:`skincal.train.read_curve`)."""
    figure = new_figure(10.5, 3.2, title)
    for axes, (column, label, factor) in zip(figure.subplots(1, 3), _PANELS, strict=True):
        for (name, curve), colour in zip(curves.items(), SEVERAL * len(curves), strict=False):
            steps, values = smoothed(curve["steps"], curve[column])
            axes.plot(1e-3 * steps, factor * values, color=colour, label=as_it_is(name))
        axes.set_xlabel("environment steps [thousands]")
        axes.set_title(label)
        axes.grid(axis="y")
        axes.set_ylim(bottom=0)
        if len(curves) > 1 and column == "reward":
            axes.legend(loc="lower right")
    return figure


def smoothed(steps: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return means over blocks of :data:`SMOOTH_STEPS`, without empty blocks."""
    block, finite = (steps - 1) // SMOOTH_STEPS, np.isfinite(values)
    blocks = np.unique(block[finite])
    at = np.array([steps[block == b].mean() for b in blocks])
    return at, np.array([values[(block == b) & finite].mean() for b in blocks])
