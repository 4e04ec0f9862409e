"""The figure of the clock alignment of joined files."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from skincal.report.style import BLUE, GREY, RED, new_figure, styled

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from skincal.imports.alignment import JoinedClock


@styled
def clocks_figure(clocks: Sequence[JoinedClock]) -> Figure:
    """Draw one row per file: the two traces at the chosen offset, and the correlation around it."""
    figure = new_figure(11, 3.2 * len(clocks), "Clocks of the joined files")
    grid = figure.subplots(len(clocks), 2, width_ratios=(2.2, 1.0), squeeze=False)
    for (traces, lags), clock in zip(grid, clocks, strict=True):
        start = clock.time_s[0] if len(clock.time_s) else 0.0
        for values, colour, label in zip(clock.traces, (GREY, BLUE), ("taxels", clock.by), strict=True):
            traces.plot(clock.time_s - start, values, color=colour, label=label, linewidth=1.0)
        title = f"{clock.name}: correlation {clock.correlation:.3f}"
        traces.set(xlabel="time [s]", ylabel="part of the range")
        traces.set_title(title)
        traces.legend(loc="upper right")
        lags.plot(clock.lags_s, clock.correlations, color=BLUE)
        lags.axvline(clock.offset_s, color=RED, linewidth=1.0)
        if np.isfinite(clock.sigma_s):
            ends = clock.offset_s - 2 * clock.sigma_s, clock.offset_s + 2 * clock.sigma_s
            lags.axvspan(*ends, color=RED, alpha=0.25, linewidth=0)
        how = f"± {clock.sigma_s:.2g} s" if clock.estimated else "as given"
        lags.set(xlabel="offset [s]", ylabel="correlation", title=f"offset {clock.offset_s:+.4f} s, {how}")
        lags.ticklabel_format(useOffset=False, style="plain")
    return figure
