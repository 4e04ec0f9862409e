"""The gap on presses that nobody has fitted: error before, after and of the noise, press by press and in total."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from skincal.dataset import Dataset
from skincal.gap.split import FINAL
from skincal.model.arrays import FloatArray
from skincal.report.style import BLACK, BLUE, GREY, ORANGE, new_figure, style

if TYPE_CHECKING:
    from skincal.diagnose.diagnosis import Diagnosis

MOST_LABELLED = 30


def gap_figure(found: Diagnosis, dataset: Dataset) -> Figure:
    """Draws the held-out error of every press, and of all of them together.

    Args:
        found: a diagnosis.
        dataset: names the presses.

    Returns:
        A figure with two panels.
    """
    what = "frames" if found.session.has_frames else "hold means"
    title = f"Error on {found.gap.presses} presses ({found.gap.frames} {what}) that neither fit nor choice has seen"
    with style():
        figure = new_figure(11, 4.0, title)
        presses, total = figure.subplots(1, 2, width_ratios=(3.2, 1.0), sharey=True)
        _draw_presses(presses, found, dataset)
        _draw_total(total, found)
        presses.set_ylim(bottom=0)
        presses.margins(y=0.12)
    return figure


def heldout_names(found: Diagnosis, dataset: Dataset) -> list[str]:
    """Names of the held-out presses in the order of ``gap.errors``; glitches are not among them."""
    session, reading = found.session, found.material.reading
    seen = np.zeros(session.presses, dtype=np.bool_)
    touching = session.press >= 0
    np.logical_or.at(seen, session.press[touching], reading.seen[touching].any(axis=1))
    rows = np.flatnonzero(seen & (found.split.part[: len(seen)] == FINAL))
    if len(rows) != len(found.gap.errors):
        return [str(k + 1) for k in range(len(found.gap.errors))]
    return [str(dataset.presses.press[row]) for row in rows]


def press_rms(found: Diagnosis) -> FloatArray:
    """(presses, 3) root mean square error before, after and of the noise [counts]."""
    sums = found.gap.errors
    return np.sqrt(sums[:, :3] / np.maximum(sums[:, 3:], 1.0))


def _draw_presses(axes: Axes, found: Diagnosis, dataset: Dataset) -> None:
    rms, names = press_rms(found), heldout_names(found, dataset)
    place = np.arange(len(rms))
    tried = [e.name for e in found.effects] or list(found.taken_back)
    if tried:
        axes.vlines(place, rms[:, 1], rms[:, 0], color=GREY, linewidth=1)
    axes.plot(place, rms[:, 0], "o", color=ORANGE, markersize=6, label="base model")
    if tried:
        label = "with " + " and ".join(tried) + ("" if found.effects else ", not added")
        axes.plot(place, rms[:, 1], "o", color=BLUE, markersize=6, label=label)
    axes.hlines(rms[:, 2], place - 0.35, place + 0.35, color=BLACK, linewidth=1.4, label="noise alone")
    step = max(1, int(np.ceil(len(place) / MOST_LABELLED)))
    axes.set_xticks(place[::step], names[::step])
    axes.set(xlabel="press (its number in the dataset)", ylabel="rms error of a taxel [counts]")
    axes.set_title("Press by press")
    axes.grid(axis="y")
    axes.legend(loc="lower left", bbox_to_anchor=(0.28, 1.0), ncols=3, borderaxespad=0.2)


def _draw_total(axes: Axes, found: Diagnosis) -> None:
    gap = found.gap
    bars = [("base\nmodel", gap.before, ORANGE)]
    if found.effects or found.taken_back:
        bars.append(("with\neffects" if found.effects else "not\nadded", gap.after, BLUE))
    bars.append(("noise\nalone", gap.floor, GREY))
    for k, (_, value, colour) in enumerate(bars):
        axes.bar(k, value, color=colour, width=0.65)
        axes.annotate(f"{value:.3g}", (k, value), (0, 3), textcoords="offset points", ha="center", fontsize=9)
    axes.set_xticks(np.arange(len(bars)), [b[0] for b in bars])
    axes.set_title("All together" + (f": {closed_words(found)}" if found.effects else ""))
    axes.grid(axis="y")


def closed_words(found: Diagnosis) -> str:
    """How much of the gap is gone, with its interval."""
    if found.only_places:
        return "places take\nit up either way"
    if not np.isfinite(found.gap.closed):
        return "no gap to close"
    low, high = (100 * end for end in found.gap.interval)
    return f"{100 * found.gap.closed:.0f} % closed\n({low:.0f} to {high:.0f} %)".replace("-", "−")
