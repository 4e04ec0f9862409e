"""Figures of a dataset: its presses and the taxels that responded; the clocks of the files that it came from."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, Colormap, ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from skincal.dataset import IDLE, Dataset
from skincal.dataset.dataset import session_times_s
from skincal.dataset.placement import patch_coordinates
from skincal.dataset.rest import ACTIVE_COUNTS, active_taxels
from skincal.model.arrays import BoolArray, FloatArray
from skincal.report import style

if TYPE_CHECKING:
    from skincal.imports.alignment import JoinedClock


FEW_NUMBERS = 8
"""Up to this number of active taxels, each number has its own colour."""

LARGEST_MARK_PT2 = 110.0
MOST_LINE_POINTS = 20_000
MOST_NAMED_TAXELS = 36


@style.styled
def dataset_figure(dataset: Dataset, threshold_counts: float = ACTIVE_COUNTS) -> Figure:
    """Draw a dataset: the patch, the forces, the number of active taxels, the session and the taxels."""
    active = active_taxels(dataset, threshold_counts)
    name = dataset.folder.name if dataset.folder else "dataset"
    figure = style.new_figure(11.5, 8.5, f"{name}: {len(dataset.presses)} presses")
    grid = figure.add_gridspec(3, 3, width_ratios=(1.0, 1.0, 0.95), height_ratios=(1, 1, 0.9))
    number, unit = active.sum(axis=1), dataset.meta.sensor.unit_label
    _draw_patch(figure, figure.add_subplot(grid[:2, :2]), dataset, number)
    _draw_forces(figure.add_subplot(grid[0, 2]), dataset.presses.force_n)
    _draw_numbers(figure.add_subplot(grid[1, 2]), number, threshold_counts, unit)
    _draw_session(figure.add_subplot(grid[2, :2]), dataset)
    _draw_taxels(figure, figure.add_subplot(grid[2, 2]), dataset, active)
    return figure


def _draw_patch(figure: Figure, axes: Axes, dataset: Dataset, number: NDArray[np.int64]) -> None:
    pose, layout = dataset.nominal_pose(), dataset.layout()
    reach = 3 * float(np.abs(layout.bounds_m).max())
    uv = 1e3 * patch_coordinates(dataset.surface(), pose, dataset.presses.position_m, reach)
    style.draw_outlines(axes, layout)
    if layout.taxels <= MOST_NAMED_TAXELS:
        for j, corner in enumerate(1e3 * (layout.centres_m - layout.sizes_m / 2)):
            name = "{},{}".format(*divmod(j, dataset.meta.sensor.cols))
            axes.annotate(name, corner, (2, 2), textcoords="offset points", fontsize=6, color=style.GREY)
    given = np.asarray(np.isfinite(uv).all(axis=1))
    near = given & style.near_patch(uv, 1e3 * layout.bounds_m)
    axes.update_datalim(1e3 * layout.bounds_m)
    axes.margins(0.06)
    style.equal_axes_mm(axes, "u", "v")
    axes.set_title("Presses on the patch", pad=22)
    mount = dataset.meta.mount
    across = f"x {1e3 * mount.x_m:g} mm" if mount.x_m is not None else f"beta {mount.beta_deg:g}°"
    pose = f"at its nominal pose: y {1e3 * mount.y_m:g} mm, {across}, alpha {mount.alpha_deg:g}°"
    notes = [pose, *_notes(given, near, uv)]
    axes.annotate("; ".join(notes), (0, 1), (0, 6), "axes fraction", "offset points", fontsize=8, va="bottom")
    if near.any():
        _draw_presses(figure, axes, uv[near], dataset.presses.force_n[near], number[near])
    axes.autoscale_view()


def _notes(given: BoolArray, near: BoolArray, uv: FloatArray) -> list[str]:
    notes = []
    if not given.all():
        notes.append(f"{int(np.sum(~given))} presses without a position")
    if np.any(given & ~near):
        notes.append(f"{int(np.sum(given & ~near))} presses far away are not drawn")
    if near.sum() > 1 and np.ptp(uv[near], axis=0).max() < 1e-6:
        notes.append(f"{int(near.sum())} presses at one place")
    return notes


def _draw_presses(
    figure: Figure, axes: Axes, uv: FloatArray, force: FloatArray, number: NDArray[np.int64]
) -> None:
    """Draw one mark per press: its colour is the number of active taxels, its area the force."""
    pt2_per_n = LARGEST_MARK_PT2 / max(float(np.percentile(force, 95)), 1e-12)
    area = np.clip(force * pt2_per_n, 4, 2 * LARGEST_MARK_PT2)
    colours, norm = _colours(int(number.max(initial=0)))
    # Draw hard presses first, so that gentle ones lie on top of them.
    order = np.argsort(-force)
    look: Any = {"edgecolors": style.BLACK, "linewidths": 0.5, "alpha": 0.85}
    axes.scatter(*uv[order].T, s=area[order], c=number[order], cmap=colours, norm=norm, **look)
    bar = figure.colorbar(ScalarMappable(norm, colours), ax=axes, shrink=0.6, pad=0.01, label="active taxels")
    if isinstance(norm, BoundaryNorm):
        ticks = list(range(int(number.max(initial=0)) + 1))
        bar.set_ticks(ticks, labels=[str(n) for n in ticks])
        bar.ax.tick_params(length=0)
    else:
        bar.ax.yaxis.set_major_locator(MaxNLocator(integer=True))
    _explain_areas(axes, force, pt2_per_n)


def _explain_areas(axes: Axes, force: FloatArray, pt2_per_n: float) -> None:
    """Explain the areas by marks of up to three round forces over the range of the data."""
    highest = float(np.percentile(force, 95))
    ticks = MaxNLocator(nbins=4, steps=[1, 2, 5, 10]).tick_values(0, highest)
    look: Any = {"linestyle": "", "marker": "o", "markerfacecolor": "white", "markeredgecolor": style.BLACK}
    handles = [
        Line2D([], [], markersize=max(f * pt2_per_n, 4) ** 0.5, markeredgewidth=0.5, label=f"{f:g} N", **look)
        for f in ticks
        if 0 < f <= highest
    ]
    style.legend_below(axes, len(handles), handles=handles, title="force", alignment="left")


def _colours(most: int) -> tuple[Colormap, Normalize]:
    colours = mpl.colormaps[style.SEQUENTIAL]
    if most > FEW_NUMBERS:
        return colours, Normalize(0, most)
    steps = ListedColormap(colours(np.linspace(0.05, 1, most + 1)))
    return steps, BoundaryNorm(np.arange(most + 2) - 0.5, most + 1)


def _draw_forces(axes: Axes, force: FloatArray) -> None:
    axes.hist(
        force, bins=min(max(len(force) // 4, 5), 30), color=style.BLUE, edgecolor="white", linewidth=0.5
    )
    axes.axvline(float(np.median(force)), color=style.ORANGE, label=f"median {np.median(force):.4g} N")
    axes.set(title="Forces", xlabel="force in the hold [N]", ylabel="presses")
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    axes.margins(y=0.25)
    axes.legend(loc="upper right")


def _draw_numbers(axes: Axes, number: NDArray[np.int64], threshold: float, unit: str) -> None:
    most = int(number.max(initial=0))
    if most <= 2 * FEW_NUMBERS:
        bars = axes.bar(np.arange(most + 1), np.bincount(number), width=0.8)
        for n, bar in enumerate(bars):
            bar.set_color(style.BLUE if n >= 2 else style.GREY)
        axes.bar_label(bars, fontsize=8, padding=1)
        axes.set_xticks(np.arange(most + 1))
        axes.margins(y=0.15)
    else:
        axes.hist(number[number < 2], bins=1, range=(-0.5, 1.5), color=style.GREY)
        axes.hist(number[number >= 2], bins=20, color=style.BLUE, edgecolor="white", linewidth=0.5)
    title = "Active taxels (grey: fewer than two)" if number.min(initial=2) < 2 else "Active taxels"
    axes.set(title=title, xlabel=f"taxels more than {threshold:.3g} {unit} above rest", ylabel="presses")
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))


def _draw_session(axes: Axes, dataset: Dataset) -> None:
    times, frames, force_n = session_times_s(dataset), dataset.frames, dataset.presses.force_n
    if frames is not None and times is not None:
        step = max(len(frames) // MOST_LINE_POINTS, 1)
        force = np.where(frames.phase == IDLE, np.nan, frames.force_n)[::step]
        line: Any = {"color": style.GREY, "linewidth": 0.6, "alpha": 0.7, "label": "frames with contact"}
        axes.plot(frames.time_s[::step], force, **line)
    x = np.arange(len(dataset.presses), dtype=float) if times is None else times
    axes.set_xlabel("press, in the order of the table" if times is None else "session time [s]")
    for label, marker, colour, rows in _branches(dataset):
        axes.plot(x[rows], force_n[rows], marker, color=colour, markersize=4, label=label)
    axes.set(title="Session", ylabel="force [N]")
    axes.set_ylim(bottom=min(0.0, float(force_n.min())))
    axes.grid(axis="y")
    axes.margins(y=0.15)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=4, borderaxespad=0.0)


def _branches(dataset: Dataset) -> list[tuple[str, str, str, BoolArray]]:
    """Return label, marker, colour and rows of the presses by branch."""
    branch = dataset.presses.column("branch")
    if branch is None:
        return [("hold of a press", "o", style.BLUE, np.ones(len(dataset.presses), dtype=bool))]
    kinds = (
        ("up", "reached from below", "^", style.BLUE),
        ("down", "reached from above", "v", style.ORANGE),
        ("", "branch not given", "o", style.BLACK),
    )
    found = [(label, marker, colour, np.asarray(branch == value)) for value, label, marker, colour in kinds]
    return [item for item in found if item[3].any()]


def _draw_taxels(figure: Figure, axes: Axes, dataset: Dataset, active: BoolArray) -> None:
    """Draw the number of presses in which each taxel is active, arranged as in memory; a cross means none."""
    sensor = dataset.meta.sensor
    answers = active.sum(axis=0).reshape(sensor.rows, sensor.cols)
    # A tall image is drawn lying down, to use the space.
    lying = sensor.rows > 1.5 * sensor.cols
    shown, labels = (answers.T, ("row r", "column c")) if lying else (answers, ("column c", "row r"))
    aspect = "auto" if lying else None
    image = axes.imshow(shown, origin="lower", cmap=style.SEQUENTIAL, vmin=0, aspect=aspect)
    axes.set(xlabel=labels[0], ylabel=labels[1])
    silent = np.argwhere(shown == 0)[:, ::-1]
    if len(silent):
        axes.plot(*silent.T, "x", color="white", markersize=5, markeredgewidth=1.0)
    axes.set_anchor("W")
    axes.set_title("Presses per active taxel" + (f" (x: none, {len(silent)})" if len(silent) else ""))
    bar = figure.colorbar(image, ax=axes, pad=0.02, label="presses")
    for axis in (axes.xaxis, axes.yaxis, bar.ax.yaxis):
        axis.set_major_locator(MaxNLocator(integer=True))


@style.styled
def clocks_figure(clocks: Sequence[JoinedClock]) -> Figure:
    """Draw one row per file: the two traces at the chosen offset, and the correlation around it."""
    figure = style.new_figure(11, 3.2 * len(clocks), "Clocks of the joined files")
    grid = figure.subplots(len(clocks), 2, width_ratios=(2.2, 1.0), squeeze=False)
    for (traces, lags), clock in zip(grid, clocks, strict=True):
        start = clock.time_s[0] if len(clock.time_s) else 0.0
        for values, colour, label in zip(
            clock.traces, (style.GREY, style.BLUE), ("taxels", clock.by), strict=True
        ):
            traces.plot(clock.time_s - start, values, color=colour, label=label, linewidth=1.0)
        title = f"{clock.name}: correlation {clock.correlation:.3f}"
        traces.set(xlabel="time [s]", ylabel="part of the range", title=title)
        traces.legend(loc="upper right")
        lags.plot(clock.lags_s, clock.correlations, color=style.BLUE)
        lags.axvline(clock.offset_s, color=style.RED, linewidth=1.0)
        if np.isfinite(clock.sigma_s):
            ends = clock.offset_s - 2 * clock.sigma_s, clock.offset_s + 2 * clock.sigma_s
            lags.axvspan(*ends, color=style.RED, alpha=0.25, linewidth=0)
        how = f"± {clock.sigma_s:.2g} s" if clock.estimated else "as given"
        lags.set(xlabel="offset [s]", ylabel="correlation", title=f"offset {clock.offset_s:+.4f} s, {how}")
        lags.ticklabel_format(useOffset=False, style="plain")
    return figure
