"""The report of a fit to uniform pressure: the scale and the linearity of each taxel."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from skincal.calibrate import UniformOutcome
from skincal.dataset import Dataset
from skincal.report.fit import with_digits
from skincal.report.page import picture, write_page
from skincal.report.style import BLACK, BLUE, GREY, ORANGE, draw_taxels, equal_axes_mm, new_figure, styled

_MOST_LINES = 60


def write_uniform_report(outcome: UniformOutcome, dataset: Dataset, folder: str | Path) -> None:
    """Write ``report.html`` and its figures (``scales.png``, ``answers.png``) into a folder."""
    folder, calibration, unit = Path(folder), outcome.calibration, dataset.meta.sensor.unit
    figures = {"scales": scales_figure(outcome), "answers": answers_figure(outcome, dataset)}
    low, high = calibration.intervals["scale_per_n"]
    responding = outcome.scales.responding
    write_page(
        "fit_uniform.html",
        folder,
        dataset,
        calibration,
        figures=[picture(figure, stem, folder, unit) for stem, figure in figures.items()],
        responding=int(responding.sum()),
        taxels=len(responding),
        median=with_digits(outcome.scales.common_per_n, 3),
        low=with_digits(low, 3),
        high=with_digits(high, 3),
    )


@styled
def scales_figure(outcome: UniformOutcome) -> Figure:
    """Draw the scales on the patch, and their distribution."""
    scales, layout = outcome.scales, outcome.calibration.layout()
    own = scales.scale_per_n[scales.responding]
    figure = new_figure(11, 5.2, "Scale of each taxel [counts/N]")
    axes, distribution = figure.subplots(1, 2)
    low, high = np.quantile(own, [0.02, 0.98])
    norm = Normalize(float(low), max(float(high), float(low) + 1e-9))
    boxes = draw_taxels(axes, layout, np.where(scales.responding, scales.scale_per_n, np.nan), norm, "YlGnBu")
    equal_axes_mm(axes, "u", "v")
    figure.colorbar(boxes, ax=axes, extend="both")
    distribution.hist(own, bins=min(40, max(5, len(own) // 4)), color=BLUE)
    distribution.axvline(scales.common_per_n, color=BLACK, linewidth=1.0, label="common scale (median)")
    distribution.set(xlabel="scale [counts/N]", ylabel="taxels")
    distribution.legend()
    return figure


@styled
def answers_figure(outcome: UniformOutcome, dataset: Dataset) -> Figure:
    """Draw values and residuals of the taxels against their load."""
    scales = outcome.scales
    taxels = np.flatnonzero(scales.responding)
    taxels = taxels[np.unique(np.linspace(0, len(taxels) - 1, _MOST_LINES).round().astype(int))]
    branch = dataset.presses.column("branch")
    down = np.zeros(len(outcome.values), dtype=np.bool_) if branch is None else branch.astype(str) == "down"
    figure = new_figure(11, 5.2, "Responses to uniform pressure")
    values = np.where(outcome.use, outcome.values, np.nan)
    left, right = figure.subplots(1, 2)
    _lines(left, outcome.loads_n, values, taxels, down)
    load = np.linspace(0.0, float(np.nanmax(outcome.loads_n)), 2)
    left.plot(load, scales.common_per_n * load, color=BLACK, linewidth=1.2, label="median scale")
    left.set(xlabel="load of a taxel [N]", ylabel="value above rest [counts]")
    _lines(right, outcome.loads_n, scales.residual, taxels, down)
    right.axhline(0.0, color=GREY, linewidth=0.8)
    spread = np.nanquantile(scales.residual, [0.01, 0.99])
    right.set_ylim(2 * min(float(spread[0]), -0.5), 2 * max(float(spread[1]), 0.5))
    right.set(xlabel="load of a taxel [N]", ylabel="measured − line [counts]")
    for axes in (left, right):
        axes.legend(loc="upper left")
    return figure


def _lines(axes: Axes, load: np.ndarray, value: np.ndarray, taxels: np.ndarray, down: np.ndarray) -> None:
    """Draw thin lines of taxels, rising and falling pressure apart, and the median of each."""
    for rows, colour, name in ((~down, BLUE, "rising"), (down, ORANGE, "falling")):
        if not rows.any():
            continue
        order = np.flatnonzero(rows)[np.argsort(load[rows][:, taxels[0]])]
        axes.plot(load[order][:, taxels], value[order][:, taxels], color=colour, alpha=0.15, linewidth=0.7)
        name = name if down.any() else "taxels"
        middle = np.nanmedian(value[order][:, taxels], axis=1)
        axes.plot(load[order][:, taxels[0]], middle, color=colour, linewidth=2.0, label=f"{name}, median")
