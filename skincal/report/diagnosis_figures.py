"""The figures of a diagnosis: the gap, counts over time, where the residuals lie, the candidates, and the audit."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from skincal.report import style
from skincal.report.page import percent

if TYPE_CHECKING:
    from skincal.dataset import Dataset
    from skincal.diagnosis.audit import AuditReport
    from skincal.diagnosis.diagnosis import Diagnosis


_SHOWN, _LATER = 4, 8
"""Number of presses whose counts are drawn over time, and of candidates of each round after the first."""


@style.styled
def gap_figure(diagnosis: Diagnosis, dataset: Dataset) -> Figure:
    """Draw the error before and after, and the noise, of every test press."""
    sums = diagnosis.gap.errors
    rms = np.sqrt(sums[:, :3] / np.maximum(sums[:, 3:], 1.0)) if len(sums) else np.zeros((0, 3))
    title = f"Error on {len(sums)} test presses, used by neither fit nor selection"
    figure = style.new_figure(11, 3.6, title)
    axes = figure.subplots()
    order = np.argsort(-rms[:, 0]) if len(rms) else np.zeros(0, dtype=int)
    x = np.arange(len(rms))
    axes.plot(x, rms[order, 0], "o", color=style.ORANGE, label="base model")
    if diagnosis.effects:
        axes.plot(x, rms[order, 1], "o", color=style.BLUE, label="with the named effects")
    axes.plot(x, rms[order, 2], "_", color=style.BLACK, markersize=12, label="noise")
    names = [str(dataset.presses.press[p]) for p in diagnosis.gap.presses[: len(rms)]]
    axes.set_xticks(x, [names[k] for k in order] if len(names) == len(rms) else [])
    axes.set(xlabel="press", ylabel="rms per taxel [counts]", ylim=(0, 1.08 * axes.get_ylim()[1]))
    axes.legend()
    return figure


@style.styled
def curves_figure(diagnosis: Diagnosis, dataset: Dataset) -> Figure:
    """Draw counts over time, measured and simulated, of the most informative presses and taxels.

    These are the presses that the named effects improve most; without named effects, those with the largest error.
    """
    observed = diagnosis.observed
    session, forward = observed.session, observed.fitter.forward
    base, last = diagnosis.found.base, diagnosis.found.final
    assert session.counts is not None
    fits = [forward.mean @ forward.noise.written(x.prediction.values + x.state.rest)[0] for x in (base, last)]
    score = np.nan_to_num(session.counts - fits[0]) ** 2
    if diagnosis.effects:
        score = score - np.nan_to_num(session.counts - fits[1]) ** 2
    presses = [p for p in np.unique(session.press[session.press >= 0]).tolist() if not observed.is_test[p]]
    chosen = sorted(presses, key=lambda p: -float(score[session.press == p].sum()))[:_SHOWN]
    observations = np.flatnonzero(session.observation >= 0)
    time = np.zeros(len(session))
    time[session.observation[observations]] = session.samples.elapsed_s[observations]
    title = "Counts over time, measured and simulated, of the most informative presses"
    figure = style.new_figure(13, 3.2, title)
    for axes, p in zip(
        np.ravel(figure.subplots(1, max(len(chosen), 1), squeeze=False)), chosen, strict=False
    ):
        rows = np.flatnonzero(session.press == p)
        j = int(np.argmax(score[rows].sum(axis=0)))
        x = time[rows] - time[rows[0]] if session.has_frames else np.arange(len(rows))
        axes.plot(x, session.counts[rows, j], ".", color=style.BLACK, markersize=4, label="measured")
        axes.plot(x, fits[0][rows, j], color=style.ORANGE, label="base model")
        if diagnosis.effects:
            axes.plot(x, fits[1][rows, j], color=style.BLUE, label="with the named effects")
        row, col = divmod(j, dataset.layout().cols)
        axes.set(title=f"press {dataset.presses.press[p]}, taxel_{row}_{col}", xlabel="time [s]")
    figure.axes[0].set_ylabel("counts")
    figure.axes[0].legend()
    return figure


@style.styled
def where_figure(diagnosis: Diagnosis, dataset: Dataset) -> Figure:
    """Draw each taxel's residual over the noise (rms), and parts of the session with more than their share."""
    fitter = diagnosis.observed.fitter
    from skincal.inference.start import raw_residual

    models = [("base model", diagnosis.found.base), ("with the named effects", diagnosis.found.final)]
    models = models if diagnosis.effects else models[:1]
    figure = style.new_figure(12, 3.8)
    panels = np.ravel(figure.subplots(1, 3, width_ratios=(1, 1, 1.6)))
    maps = []
    for _, fit in models:
        residual = np.where(np.isfinite(fitter.counts), raw_residual(fitter, fit.state), np.nan)
        maps.append(np.sqrt(np.nanmean(residual**2, axis=0)))
    norm = Normalize(0, max(float(np.nanmax(maps[0])), 1.5))
    for axes, (title, _), values in zip(panels, models, maps, strict=False):
        style.draw_taxels(axes, dataset.layout(), values, norm, style.SEQUENTIAL)
        axes.set(aspect="equal", xticks=[], yticks=[], title=f"{title}: residual over noise")
        axes.spines[:].set_visible(False)
    if len(models) < 2:
        panels[1].set_axis_off()
    parts = diagnosis.depends[::-1]
    panels[2].barh([s.meaning for s in parts], [s.times for s in parts], color=style.BLUE)
    panels[2].axvline(1.0, color=style.BLACK, linewidth=1)
    panels[2].set_xlabel("mean excess over that of the session, or of all presses")
    return figure


@style.styled
def candidates_figure(diagnosis: Diagnosis, dataset: Dataset) -> Figure:
    """Draw the gain of every candidate with its standard error, the null's quantile, and the required gain."""
    del dataset
    rounds = [r if number == 0 else r[:_LATER] for number, r in enumerate(diagnosis.found.rounds) if r]
    null, names = diagnosis.found.null, {n for e in diagnosis.effects for n in e.consistent_with}
    below = f"{percent(null.probability)} of sessions without effects"
    firsts = {e.name for e in diagnosis.effects}
    figure = style.new_figure(10, 1.2 + sum(0.22 * len(r) + 0.5 for r in rounds), "Gain on held-out presses")
    heights = [len(r) for r in rounds] or [1]
    panels = np.ravel(figure.subplots(len(heights), 1, sharex=True, squeeze=False, height_ratios=heights))
    for number, (axes, candidates) in enumerate(zip(panels, rounds, strict=False)):
        rows = np.arange(len(candidates))
        quantiles = [max(null.quantile(c.name), 0.0) for c in candidates]
        axes.barh(rows, quantiles, color=style.LIGHT, height=0.8, label=below)
        axes.plot([c.limit for c in candidates], rows, "|", color=style.BLACK, markersize=9, label="required")
        for colour, label, chosen in (
            (style.BLUE, "named", [c.name in firsts for c in candidates]),
            (style.GREEN, "not distinguishable from it", [c.name in names - firsts for c in candidates]),
            (style.GREY, "others", [c.name not in names for c in candidates]),
        ):
            k = np.flatnonzero(chosen)
            if not len(k):
                continue
            gain, error = (np.array([getattr(candidates[i], a) for i in k]) for a in ("gain", "error"))
            axes.errorbar(gain, k, xerr=error, fmt="o", color=colour, markersize=4, label=label)
        axes.set_yticks(rows, [c.name for c in candidates])
        axes.set_ylim(len(candidates) - 0.4, -0.6)
        model = "the base model" if number == 0 else f"the model of round {number}"
        axes.set_title(f"round {number + 1}: added to {model}")
    panels[0].set_xscale("symlog", linthresh=1.0)
    figure.legend(*_legend(panels), loc="upper right", ncols=5, fontsize=7)
    panels[-1].set_xlabel("gain in log-likelihood [nats], with its standard error")
    return figure


def _legend(panels: Iterable[Axes]) -> tuple[list[Any], list[str]]:
    handles: dict[str, Any] = {}
    for axes in panels:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    return list(handles.values()), list(handles)


WEAKEST, STRONGEST = 1e-3, 30.0
"""Limits of the axis of strengths, at which bars end."""


@style.styled
def audit_figure(report: AuditReport) -> Figure:
    """Draw the smallest visible strengths as bars, and the matrix of cosines between effects."""
    what = "planned presses" if report.planned else "presses"
    title = f"{len(report.visible)} of {len(report.effects)} effects are visible in {report.presses} {what}"
    figure = style.new_figure(13.5, 6.6, title)
    bars, matrix = figure.subplots(1, 2, width_ratios=(1.0, 1.25))
    _draw_strengths(bars, report)
    _draw_overlaps(figure, matrix, report)
    return figure


def _draw_strengths(axes: Axes, report: AuditReport) -> None:
    place = np.arange(len(report.effects))
    smallest = np.array([effect.smallest_strength for effect in report.effects.values()])
    ends = np.clip(smallest, WEAKEST, STRONGEST)
    colours = [style.BLUE if name in report.visible else style.RED for name in report.effects]
    axes.set_xscale("log")
    axes.barh(place, 1 / ends, color=colours, height=0.7)
    axes.set_xlim(1 / STRONGEST, 1 / WEAKEST)
    axes.axvline(1.0, color=style.BLACK, linewidth=1)
    for k, value in enumerate(smallest):
        text = f"{value:.2g}" if value < STRONGEST else f"> {STRONGEST:g}" if np.isfinite(value) else "never"
        point = (max(1 / ends[k], 1.15 / STRONGEST), k)
        axes.annotate(
            text, point, (3, 0), textcoords="offset points", va="center", fontsize=7.5, color=style.BLACK
        )
    axes.set_yticks(place, list(report.effects))
    axes.invert_yaxis()
    label = "typical strength over the smallest visible one; right of the line: visible"
    axes.set(xlabel=label, title="Visibility: 1 / smallest visible strength (number: that strength)")
    axes.grid(axis="x")


def _draw_overlaps(figure: Figure, axes: Axes, report: AuditReport) -> None:
    names = list(report.effects)
    cosines = np.full((len(names), len(names)), np.nan)
    for i, effect in enumerate(report.effects.values()):
        if effect.distance > 0:
            cosines[i] = [effect.overlaps.get(other, np.nan) for other in names]
    shown = axes.imshow(cosines, vmin=0, vmax=1, cmap=style.SEQUENTIAL)
    for i, effect in enumerate(report.effects.values()):
        for other in effect.consistent_with[1:]:
            corner = (names.index(other) - 0.5, i - 0.5)
            axes.add_patch(Rectangle(corner, 1, 1, fill=False, edgecolor=style.RED, linewidth=1.8))
    axes.set_facecolor(style.GREY)
    axes.set_xticks(np.arange(len(names)), names, rotation=90)
    axes.set_yticks(np.arange(len(names)), names)
    axes.set_title(f"Similarity of the effects of column and row; red: cosine above {report.options.alike:g}")
    figure.colorbar(shown, ax=axes, shrink=0.8, label="cosine")
