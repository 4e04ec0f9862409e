"""What was tried: scores of effects on presses they were not fitted to, against sessions with nothing hidden."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from skincal.gap.choice import Round
from skincal.gap.null import Null
from skincal.model.arrays import FloatArray
from skincal.report.style import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    LIGHT,
    ORANGE,
    few_logarithmic_ticks,
    new_figure,
    style,
)

if TYPE_CHECKING:
    from skincal.diagnose.diagnosis import Diagnosis

LEAST = 0.1
"""Scores below this many units are drawn at the end of the axis."""


def candidates_figure(found: Diagnosis) -> Figure:
    """Draws the scores of all rounds on one axis, in units of what an effect reaches in one null session of twenty.

    Args:
        found: a diagnosis.

    Returns:
        A figure: on top the best scores of the null sessions, by contact law; below, a panel for each round.
    """
    rounds, null = found.choice.rounds, found.null
    heights = [0.3 * len(set(null.laws)) + 0.45, *(0.27 * len(r.found) + 0.5 for r in rounds)]
    with style():
        figure = new_figure(10, sum(heights) + 0.9)
        axes = list(np.ravel(figure.subplots(len(heights), 1, height_ratios=heights, sharex=True)))
        axes[0].set_xscale("log")
        _draw_null(axes[0], null)
        for k, (own, one) in enumerate(zip(axes[1:], rounds, strict=True)):
            named = next((n for n in found.choice.named if n.name == one.taken), None)
            word = "named" if found.effects else "comes closest"
            _draw_round(own, one, null, () if named is None else named.consistent_with, word)
            own.set_title(_title(k, one, {n.name for n in found.choice.named}))
        critical = critical_score(found)
        highest = max([float(null.best.max()), critical, *(units(null, r).max(initial=1.0) for r in rounds)])
        axes[0].set_xlim(LEAST, 14.0 * highest)
        for own in axes:
            own.axvspan(LEAST, critical, color=LIGHT, zorder=0)
            own.axvline(critical, color=BLACK, linewidth=0.9, linestyle="--")
        few_logarithmic_ticks(axes[-1].xaxis)
        axes[-1].set_xlabel(
            "score on presses that choose [times what the effect reaches in 1 null session of 20, or 30]"
        )
    return figure


def critical_score(found: Diagnosis) -> float:
    """The score, in units, above which there is something: no more null sessions reach it than are allowed to."""
    best = np.sort(found.null.best)
    allowed = int(found.options.choice.significant * (1 + len(best))) - 1
    return float(best[-1 - max(allowed, 0)])


def units(null: Null, one: Round) -> FloatArray:
    """(n,) scores of a round in units of the null."""
    return np.array([f.scored / null.unit(f.effect) for f in one.found])


def _title(number: int, one: Round, named: set[str]) -> str:
    """What a round was, and how it ended."""
    if one.passed_over is not None:
        end = f": {one.passed_over} passed over, of a kind with what was added"
    elif one.taken is None:
        end = ": nothing was added"
    else:
        end = "" if one.taken in named else f": {one.taken} was added, and dropped at the end"
    return (
        f"Round {number + 1}: beside " + ("the base model" if number == 0 else "what was added before") + end
    )


def _draw_null(axes: Axes, null: Null) -> None:
    laws = list(dict.fromkeys(null.laws))
    own = np.array(null.laws)
    for k, law in enumerate(laws):
        best = np.maximum(null.best[own == law], LEAST)
        # A little off the line, evenly, so that dots do not hide each other.
        jitter = 0.5 * ((np.arange(len(best)) * 0.618) % 1.0 - 0.5)
        axes.plot(best, k + jitter, ".", color=GREY, markersize=4, alpha=0.7)
    axes.set_yticks(np.arange(len(laws)), [law_words(law) for law in laws])
    axes.set_ylim(len(laws) - 0.5, -0.5)
    axes.set_title(
        f"{len(null.laws)} null sessions, nothing hidden: best score of any effect in each, by contact law"
    )


def law_words(law: str) -> str:
    """A contact law in words."""
    kind, _, rest = law.partition(" ")
    words = {
        "fitted": "the fitted law",
        "layer": f"an elastic layer of {rest}",
        "power": f"stress by power {rest}",
    }
    return words.get(kind, law)


def _draw_round(axes: Axes, one: Round, null: Null, names: tuple[str, ...], word: str) -> None:
    score = units(null, one)
    order = np.argsort(-score)
    for k, i in enumerate(order.tolist()):
        effect, value = one.found[i].effect, float(score[i])
        named, rival = effect in names[:1], effect in names[1:]
        colour = BLUE if named else GREEN if rival else ORANGE if effect in one.falls else GREY
        below = value < LEAST
        at = max(value, 1.08 * LEAST)
        axes.plot(at, k, "<" if below else "o", color=colour, markersize=6)
        if effect in one.falls:
            words = word if named else "cannot be told from it" if rival else "fitted in full"
            share = 100 * min(max(one.falls[effect] / one.excess, 0.0), 1.0) if one.excess > 0 else 0.0
            axes.annotate(f"{words}: explains {share:.0f} %", (at, k), (8, 0), textcoords="offset points",
                          va="center", fontsize=8, color=BLACK)  # fmt: skip
    axes.set_yticks(np.arange(len(order)), [one.found[i].effect for i in order.tolist()])
    axes.set_ylim(len(order) - 0.5, -0.5)
    axes.grid(axis="x")
