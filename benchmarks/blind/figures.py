"""The score of the blind test as pictures: power over strength, and what was named for what was hidden."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle

from benchmarks.blind.measures import ASKED_STRONG, ASKED_WEAK
from benchmarks.blind.suites import CLASS_OF, CLASSES
from skincal.report.style import BLACK, BLUE, GREY, LIGHT, ORANGE, new_figure, style

Record = dict[str, Any]

SERIES = (("detected", "something is missing", GREY, "s"), ("right_class", "named, right class", BLUE, "o"))
NOTHING_NAMED = ("none", "unknown")

_PALE_BLUE = "#A6CBE3"
_ASKED = ((0.19, 0.39, ASKED_WEAK), (0.39, np.inf, ASKED_STRONG))
"""What is asked of the right class: from, to [g], share."""


def power_figure(bins: Sequence[Record]) -> Figure:
    """Plot detection rate and class recall over strength, with 95 % Wilson intervals.

    Args:
        bins: ``power`` of the suite ``one``.
    """
    some = [entry for entry in bins if entry["detected"]["of"]]
    with style():
        figure = new_figure(7.0, 3.4)
        axes = figure.subplots()
        places = np.arange(len(some))
        for (key, label, colour, marker), aside in zip(SERIES, (-0.09, 0.09), strict=True):
            shares = np.array([entry[key]["share"] for entry in some])
            ends = np.array([entry[key]["interval_95"] for entry in some])
            bars = np.clip(np.stack([shares - ends[:, 0], ends[:, 1] - shares]), 0.0, None)
            axes.errorbar(
                places + aside, 100.0 * shares, 100.0 * bars, fmt=marker, color=colour, capsize=2.5, label=label
            )  # fmt: skip
        for place, entry in zip(places, some, strict=True):
            asked = [share for low, high, share in _ASKED if low <= entry["g"][0] < high]
            axes.hlines(
                [100.0 * a for a in asked], place - 0.4, place + 0.4, colors=ORANGE, linestyles="dashed",
                label="asked of the right class" if asked and place == places[-1] else "",
            )  # fmt: skip
        axes.set_xticks(places, [_bin_name(entry) for entry in some])
        axes.set_ylim(0.0, 104.0)
        axes.set_xlabel("strength g of the effect")
        axes.set_ylabel("sessions [%]")
        axes.grid(axis="y")
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, 1.16), ncols=3)
    return figure


def _bin_name(entry: Record) -> str:
    low, high = entry["g"]
    name = f"{low:g} to {high:g}" if high is not None else f"above {low:g}"
    return f"{name}\n{entry['detected']['of']} sessions"


def confusion_figure(rows: Mapping[str, Mapping[str, int]]) -> Figure:
    """Plot the confusion matrix: first named effect (columns) against hidden effect (rows), in sessions.

    Args:
        rows: ``confusion`` of the suite ``one``.
    """
    order = [name for names in CLASSES.values() for name in names]
    hidden = [name for name in order if name in rows]
    named = [*order, *NOTHING_NAMED]
    named = [name for name in named if name in hidden or any(name in row for row in rows.values())]
    with style():
        figure = new_figure(8.0, 1.6 + 0.24 * len(hidden))
        axes = figure.subplots()
        for y, truth in enumerate(hidden):
            for x, name in enumerate(named):
                if count := rows[truth].get(name, 0):
                    colour, ink = _cell_colours(truth, name)
                    axes.add_patch(_square(x, y, colour))
                    axes.text(x, y, str(count), ha="center", va="center", fontsize=8, color=ink)
        _borders(axes, hidden, named)
        axes.set_xlim(-0.5, len(named) - 0.5)
        axes.set_ylim(len(hidden) - 0.5, -0.5)
        axes.set_xticks(range(len(named)), named, rotation=55, ha="right", rotation_mode="anchor")
        axes.set_yticks(range(len(hidden)), hidden)
        axes.tick_params(length=0)
        axes.set_xlabel("named first")
        axes.set_ylabel("hidden")
        keys = {"right": BLUE, "right class": _PALE_BLUE, "wrong": ORANGE, "nothing named": LIGHT}
        handles = [Patch(color=colour, label=label) for label, colour in keys.items()]
        figure.legend(handles=handles, loc="outside upper center", ncols=4)
    return figure


def _cell_colours(hidden: str, named: str) -> tuple[str, str]:
    if named == hidden:
        return BLUE, "white"
    if named in NOTHING_NAMED:
        return LIGHT, BLACK
    return (_PALE_BLUE if CLASS_OF[named] == CLASS_OF[hidden] else ORANGE), BLACK


def _square(x: float, y: float, colour: str) -> Rectangle:
    return Rectangle((x - 0.45, y - 0.45), 0.9, 0.9, color=colour, linewidth=0.0)


def _borders(axes: Axes, hidden: Sequence[str], named: Sequence[str]) -> None:
    """Lines between the classes."""
    for names, line in ((named, axes.axvline), (hidden, axes.axhline)):
        kinds = [CLASS_OF.get(name, "") for name in names]
        for place in range(1, len(kinds)):
            if kinds[place] != kinds[place - 1]:
                line(place - 0.5, color=GREY, linewidth=0.6)


def figures(suites: Record) -> dict[str, Figure]:
    """The pictures that there are sessions for, by the name of the table that says the same."""
    if "one" not in suites:
        return {}
    return {
        "power": power_figure(suites["one"]["power"]),
        "confusion": confusion_figure(suites["one"]["confusion"]),
    }
