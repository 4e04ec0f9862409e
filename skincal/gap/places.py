"""Whether measured places are off in a way that goes with something: where on the skin, the force, the hand's pose.

A fit gives every press a place of its own, and takes as wide a prior for it as the places need. Measured places that
are stretched or that yield with the force leave then no trace in the images; they show in the places alone. The moves
of presses whose images tell where they were are regressed on what ``contact_offset`` does to places, beside what the
sensor's pose does (:mod:`skincal.gap.trend`): on offsets in each hand pose, on what goes with the place, on what goes
with the force, and on all of it.

A press whose images are as right at another place (:mod:`skincal.gap.relocate`) is taken to be where its prior says,
which is a trend of its own: such presses are left out. What another contact law does to places
(:mod:`skincal.gap.law`) may be there in any case, as much of it as there is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from skincal.effects import EFFECTS
from skincal.effects.base import InputEffect
from skincal.effects.parameter import checked
from skincal.gap.candidates import Bench, Found, Start
from skincal.gap.choose import Choice, Named
from skincal.gap.free import clipped, parameters_at
from skincal.gap.hypothesis import PLACE
from skincal.gap.models import Material, Model, excess_of, extended
from skincal.gap.relocate import ambiguous
from skincal.gap.trend import beyond, explained, largest_share
from skincal.model.arrays import BoolArray, FloatArray, IntArray

NAME = "contact_offset"
_STEP = 0.1
_KNOWN = 4.0
"""A place is known where its images are worth so much more than its prior, along both directions."""
_FEWEST = 3
"""Presses for each number at least."""
_WAYS = (
    ("pose_across_m", "pose_along_m"),
    ("stretch_across", "stretch_along", "skew"),
    ("across_m_per_n", "along_m_per_n"),
)
"""Numbers of the effect that belong together."""
SIGNIFICANT, SHARE = 0.002, 0.12
"""When a trend is named: its p-value at most, and its share at least."""
_FAINT = 0.5
"""Doubtful presses hide less than this part of a trend: where there is not even so much, they are not looked for."""
_LAWS = 0.1
"""Laws move places alike; laws, and what is their own, that are less than this, relative, are left to chance."""


@dataclass(frozen=True, eq=False)
class Trend:
    """What goes with the places.

    Attributes:
        found: ``contact_offset`` with the numbers that explain it.
        share: of the variance of the moves, for the numbers that were free.
        p_value: of the clearest part of it being so clear.
        rms_m: root mean square of the moves that it explains [m].
    """

    found: Found
    share: float
    p_value: float
    rms_m: float


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
        doubtful: says which presses (P,) have images that are as right elsewhere; those say nothing. None: no press.
    """
    starts = Bench(model.hypothesis, material.session).starts(NAME)
    if not starts:
        return None
    rows = _told(model, material)
    (start,) = starts
    columns, turns = _moves(model, material, start)
    of_way = [[i for i, c in enumerate(start.coords) if c.parameter.name in way] for way in _WAYS]
    moves = model.hypothesis.places[:, :2]
    nuisance = _nuisance(model, material, errors, turns, rows)
    if doubtful is not None and _enough(rows, columns, turns):
        faint = largest_share(moves[rows], columns[rows], nuisance, of_way) <= _FAINT * SHARE
        if not faint:
            rows = rows[~doubtful()[rows]]
            nuisance = _nuisance(model, material, errors, turns, rows)
    if not _enough(rows, columns, turns):
        return None
    best = explained(moves[rows], columns[rows], nuisance, of_way, rng)
    if best is None:
        return None
    made = beyond(columns[rows][..., best.columns] @ best.x, nuisance)
    start = replace(start, coords=tuple(start.coords[int(i)] for i in best.columns))
    found = Found(start, clipped(start.coords, best.x), 0.0, 0.0)
    return Trend(found, best.share, best.p_value, _rms(made))


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
    named = (*choice.named, Named(NAME, (NAME,), trend.share, trend.p_value))
    return replace(
        choice, after=model, named=named, excess=(choice.excess[0], excess_of(model, material, null_mean))
    )


def _told(model: Model, material: Material) -> IntArray:
    """Rows of presses that were learned from and whose images tell where they were."""
    known, press = material.known, material.session.press
    rows = np.unique(press[known & (press >= 0)])
    worth = np.array([_worth(model, material, press == row) for row in rows])
    return rows[worth > _KNOWN] if len(rows) else rows


def _worth(model: Model, material: Material, own: BoolArray) -> float:
    slopes = (model.refit.slopes.place[own][..., :2] * material.options.place_prior[:2]).reshape(-1, 2)
    return float(np.linalg.eigvalsh(slopes.T @ slopes)[0])


def _moves(model: Model, material: Material, start: Start) -> tuple[FloatArray, FloatArray]:
    """Moves of presses (P, 2, n) by each number of the effect, and (P, 2, 3) by those of the pose [m]."""
    effect = EFFECTS[NAME]
    assert isinstance(effect, InputEffect)
    session, skin = material.session, model.hypothesis.skin
    samples = session.samples
    own = (session.row >= 0) & samples.touching & np.isfinite(samples.contacts.points_m).all(axis=1)
    many = len(model.hypothesis.places)
    count = np.maximum(np.bincount(session.row[own], minlength=many), 1)

    def of_press(values: FloatArray) -> FloatArray:
        return np.bincount(session.row[own], values[own], many) / count

    setting = skin.setting
    here = samples.contacts.points_m
    columns: list[FloatArray] = []
    for k in range(len(start.coords)):
        x = np.zeros(len(start.coords))
        x[k] = _STEP
        values = checked(NAME, effect.parameters, parameters_at(start.coords, x)[NAME], 1)
        there = effect.apply(samples, values, setting).contacts.points_m
        moved = (there - here) @ setting.axes.T / _STEP
        columns.append(np.stack([of_press(moved[:, 0]), of_press(moved[:, 1])], axis=-1))
    place = (here - setting.centre_m) @ setting.axes.T
    across, along = of_press(place[:, 0]), of_press(place[:, 1])
    one, none = np.ones(many), np.zeros(many)
    turns = [np.stack(pair, axis=-1) for pair in ((one, none), (none, one), (-along, across))]
    return np.stack(columns, axis=-1), np.stack(turns, axis=-1)


def _rms(moves: FloatArray) -> float:
    return float(np.sqrt((moves**2).sum(axis=1).mean()))


def _enough(rows: IntArray, columns: FloatArray, turns: FloatArray) -> bool:
    """Whether there are presses enough for so many numbers."""
    return len(rows) >= _FEWEST * (columns.shape[-1] + turns.shape[-1]) / 2


def _nuisance(
    model: Model, material: Material, errors: list[FloatArray], turns: FloatArray, rows: IntArray
) -> FloatArray:
    """Moves (R, 2, k) of some presses that are there in any case: those of the pose, and those of contact laws.

    A law moves presses to fit what it leaves, the sensor staying; as few columns as say it.
    """
    prior, press = material.options.place_prior, material.session.press
    found = np.zeros((len(rows), 2, len(errors)))
    for k, row in enumerate(rows.tolist()):
        own = press == row
        slopes = (model.refit.slopes.place[own] * prior).reshape(-1, PLACE)
        inverse = np.linalg.inv(slopes.T @ slopes + np.eye(PLACE))
        for law, error in enumerate(errors):
            found[k, :, law] = (prior * (inverse @ (slopes.T @ error[own].ravel())))[:2]
    flat = np.nan_to_num(found.reshape(2 * len(rows), len(errors)))
    length = np.linalg.norm(flat, axis=0)
    some = length > _LAWS * length.max(initial=0.0)
    left, size, _ = np.linalg.svd(flat[:, some] / length[some], full_matrices=False)
    main = left[:, size > _LAWS * size.max(initial=0.0)]
    return np.concatenate([turns[rows], main.reshape(len(rows), 2, main.shape[1])], axis=-1)
