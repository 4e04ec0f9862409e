"""Whether measured places are off in a way that goes with something: where on the skin, the force, the hand's pose.

A fit gives every press a place of its own, and takes as wide a prior for it as the places need. Measured places that
are stretched or that yield with the force leave then no trace in the images; they show in the places alone. The moves
of presses whose images tell where they were are regressed on what ``contact_offset`` does to places, beside what the
sensor's pose does (:mod:`skincal.gap.trend`): on offsets in each hand pose, on what goes with the place, on what goes
with the force, and on all of it.

Moves are compared with what would follow from the measured places and from the found ones, and the less clear answer
counts. Independent errors of the measurement look like a compression when compared with measured places; places
that the hand missed look like a stretch when compared with found ones.

A press whose images are as right at another place (:mod:`skincal.gap.relocate`) is taken to be where its prior says,
which is a trend of its own: what is found must be there without such presses as well. What another contact law does to
places (:mod:`skincal.gap.law`) may be there in any case, as much of it as there is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from skincal.effects.samples import Samples
from skincal.gap.candidates import Bench, Found
from skincal.gap.choice import Choice, Named
from skincal.gap.contest import IN_PLACES
from skincal.gap.free import clipped
from skincal.gap.models import Material, Model, excess_of, extended
from skincal.gap.place_moves import PlaceMoves, moves, told
from skincal.gap.relocate import ambiguous
from skincal.gap.trend import explained, largest_share, numbers
from skincal.model.arrays import BoolArray, FloatArray, IntArray

NAME = IN_PLACES
_FEWEST = 3
"""Moves for each number at least; a press has two."""
_WAYS = (
    ("pose_across_m", "pose_along_m"),
    ("stretch_across", "stretch_along", "skew"),
    ("across_m_per_n", "along_m_per_n"),
)
"""Numbers of the effect that belong together."""
SIGNIFICANT, SHARE = 0.002, 0.09
"""When a trend is named: its p-value at most, and its share, of the sure presses, at least."""
_CONFIRMED = 0.02
"""The p-value that a trend of all presses must reach among those that cannot lie elsewhere."""


@dataclass(frozen=True, eq=False)
class Trend:
    """What goes with the places.

    Attributes:
        found: ``contact_offset`` with the numbers that explain it.
        share: of the variance of the moves of the presses that were looked at last, for the numbers that were free.
        p_value: of the best group being so good, the larger of two, with measured and with found places; 1 where these
            contradict each other; that of the sure presses where they do not confirm it.
    """

    found: Found
    share: float
    p_value: float


def place_trend(
    model: Model,
    material: Material,
    errors: list[FloatArray],
    rng: np.random.Generator,
    doubtful: Callable[[], BoolArray] | None = None,
) -> Trend | None:
    """The trend of the places of a fit; None where presses or pose do not allow one.

    Args:
        model: a fit without ``contact_offset``.
        material: the session.
        errors: (N, J) whitened residual of each contact law.
        rng: swaps presses.
        doubtful: says which presses (P,) have images that are as right elsewhere; a trend must hold without them too.
            None: no press.
    """
    starts = Bench(model.hypothesis, material.session).starts(NAME)
    if not starts:
        return None
    (start,) = starts
    groups = [[i for i, c in enumerate(start.coords) if c.parameter.name in way] for way in _WAYS]
    hypothesis = model.hypothesis
    rows, seen = told(model, material)

    def columns_at(samples: Samples) -> tuple[FloatArray, FloatArray]:
        return moves(model, material, start, samples)

    columns, turns = columns_at(hypothesis.placed(material.session).samples)
    if not _enough(rows, columns, turns):
        return None
    found = PlaceMoves.of(model, material, errors, rows, seen, columns, turns)
    best = explained(found.moves, found.columns, found.nuisance, groups, rng)
    measured = PlaceMoves.of(model, material, errors, rows, seen, *columns_at(material.session.samples))
    other = explained(measured.moves, measured.columns, measured.nuisance, groups, rng)
    if best is None or other is None:
        return None
    # One of the two is right, and which is not known: numbers that only one of them shows are not there.
    both = best.columns[np.isin(best.columns, other.columns)]
    agree = False
    if len(both):
        share = largest_share(found.moves, found.columns, found.nuisance, [both])
        x = numbers(found.moves, found.columns[..., both], found.nuisance)
        agree = bool(x @ numbers(measured.moves, measured.columns[..., both], measured.nuisance) > 0)
        best = replace(best, columns=both, x=x, share=share)
    best = replace(best, p_value=max(best.p_value, other.p_value) if agree else 1.0)
    if doubtful is not None and best.p_value <= SIGNIFICANT:
        sure = ~doubtful()[rows]
        if not _enough(rows[sure], columns[..., best.columns], turns):
            return None
        some = PlaceMoves.of(model, material, errors, rows[sure], seen[sure], columns, turns)
        again = explained(some.moves, some.columns, some.nuisance, [best.columns.tolist()], rng)
        if again is None:
            return None
        chance = best.p_value if again.p_value <= _CONFIRMED else again.p_value
        best = replace(again, p_value=chance if again.x @ best.x > 0 else 1.0)
    start = replace(start, coords=tuple(start.coords[int(i)] for i in best.columns))
    return Trend(Found(start, clipped(start.coords, best.x), 0.0, 0.0), best.share, best.p_value)


def with_places(
    choice: Choice, material: Material, errors: list[FloatArray], null_mean: float, rng: np.random.Generator
) -> Choice:
    """A choice to which ``contact_offset`` is added where the places say so.

    Args:
        choice: of the effects that show in the images.
        material: the session.
        errors: (N, J) whitened residual of each contact law.
        null_mean: mean square of a null session's residual.
        rng: swaps presses.
    """
    if NAME in choice.after.names:
        return choice

    def doubtful() -> BoolArray:
        return ambiguous(choice.after.hypothesis, material.session, material.reading, material.options)

    trend = place_trend(choice.after, material, errors, rng, doubtful)
    if trend is None or trend.p_value > SIGNIFICANT or trend.share < SHARE:
        return choice
    model = extended(choice.after, trend.found, material)
    named = (*choice.named, Named(NAME, (NAME,), trend.share, trend.p_value, by_places=True))
    return replace(
        choice, after=model, named=named, excess=(choice.excess[0], excess_of(model, material, null_mean))
    )


def _enough(rows: IntArray, columns: FloatArray, turns: FloatArray) -> bool:
    """Whether there are presses enough for so many numbers."""
    return len(rows) >= _FEWEST * (columns.shape[-1] + turns.shape[-1]) / 2
