"""Moves of presses as a regression takes them: what was found of each, in units of what it is known to.

A fit finds a press, of which its images tell H and the measurement 1, at W = (H + 1)^-1 H of the way from where it was
measured to where it was, with a covariance that is W as well. So W^-1/2 times what was found is as uncertain in every
direction and for every press, and presses of which one direction is known better count with that one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skincal.effects import EFFECTS
from skincal.effects.contact_offset import ContactOffset
from skincal.effects.parameter import checked
from skincal.effects.samples import Samples
from skincal.gap.candidates import Start
from skincal.gap.free import parameters_at
from skincal.gap.hypothesis import PLACE
from skincal.gap.models import Material, Model
from skincal.model.arrays import BoolArray, FloatArray, IntArray, as_floats

_STEP = 0.1
_KNOWN = 1.0
"""A press counts if, in every direction, its images tell more than so many times what the measurement tells."""
_LAWS = 0.1
"""Moves by laws, and independent parts of them, that are shorter than this part of the longest are ignored."""


def told(model: Model, material: Material) -> tuple[IntArray, FloatArray]:
    """Rows (R,) of presses that learn or choose and whose images tell where they were.

    And how much they tell (R, 2, 2), whatever the force was, in units of what was measured of places.

    Args:
        model: a fit.
        material: the session.
    """
    known, press = material.known, material.session.press
    rows = np.unique(press[known & (press >= 0)])
    if not len(rows):
        return rows, np.zeros((0, 2, 2))
    seen = np.array([_sight(model, material, press == row) for row in rows])
    enough = np.linalg.eigvalsh(seen)[:, 0] > _KNOWN
    return rows[enough], seen[enough]


def _sight(model: Model, material: Material, own: BoolArray) -> FloatArray:
    slopes = (model.refit.slopes.place[own] * material.options.place_prior).reshape(-1, PLACE)
    square = slopes.T @ slopes
    of_force = square[:2, 2:]
    return as_floats(square[:2, :2] - of_force @ of_force.T / (square[2, 2] + 1.0))


@dataclass(frozen=True, eq=False)
class PlaceMoves:
    """Moves of R presses, each in units of what it is known to.

    Attributes:
        moves: (R, 2) that were found.
        columns: (R, 2, n) by each number that may explain them.
        nuisance: (R, 2, z) that are there in any case.
    """

    moves: FloatArray
    columns: FloatArray
    nuisance: FloatArray

    @classmethod
    def of(
        cls,
        model: Model,
        material: Material,
        errors: list[FloatArray],
        rows: IntArray,
        seen: FloatArray,
        columns: FloatArray,
        turns: FloatArray,
    ) -> PlaceMoves:
        """For some presses.

        Args:
            model: a fit.
            material: the session.
            errors: (N, J) whitened residual of each contact law.
            rows: (R,) of the presses.
            seen: (R, 2, 2) how much images tell of them, see :func:`told`.
            columns: (P, 2, n) moves of all presses by each number that may explain them [m].
            turns: (P, 2, 3) by the sensor's pose [m].
        """
        prior = material.options.place_prior[:2]
        size, way = np.linalg.eigh(seen)
        part = np.sqrt(size / (1 + size))

        def in_units(gain: FloatArray, of: FloatArray) -> FloatArray:
            turned = np.einsum("rik,rk,rjk->rij", way, gain, way) / prior
            return as_floats(np.einsum("rij,rj...->ri...", turned, of))

        fixed, laws = in_units(part, turns[rows]), _laws(model, material, errors, rows)
        return cls(
            in_units(1 / part, model.hypothesis.places[rows, :2]),
            in_units(part, columns[rows]),
            np.concatenate([fixed, _main(in_units(1 / part, laws))], axis=-1),
        )


def moves(model: Model, material: Material, start: Start, samples: Samples) -> tuple[FloatArray, FloatArray]:
    """Moves of presses (P, 2, n) by each number of ``contact_offset``, and (P, 2, 3) by those of the pose [m].

    Args:
        model: a fit.
        material: the session.
        start: says which numbers there are.
        samples: with the places at which moves are taken, as they were measured or as they were found.
    """
    effect = EFFECTS[start.effect]
    assert isinstance(effect, ContactOffset)
    session, skin = material.session, model.hypothesis.skin
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
        values = checked(start.effect, effect.parameters, parameters_at(start.coords, x)[start.effect], 1)
        # Over the surface, as the moves of the fit: as differences of points an offset of all poses would differ from
        # a move of the sensor by the curvature, and stand for whatever looks like that.
        moved = effect.moves_m(samples, values, setting) / _STEP
        columns.append(np.stack([of_press(moved[:, 0]), of_press(moved[:, 1])], axis=-1))
    place = (here - setting.centre_m) @ setting.axes.T
    across, along = of_press(place[:, 0]), of_press(place[:, 1])
    one, none = np.ones(many), np.zeros(many)
    turns = [np.stack(pair, axis=-1) for pair in ((one, none), (none, one), (-along, across))]
    return np.stack(columns, axis=-1), np.stack(turns, axis=-1)


def _laws(model: Model, material: Material, errors: list[FloatArray], rows: IntArray) -> FloatArray:
    """Moves (R, 2, L) by which presses fit what each contact law leaves, the sensor staying [m]."""
    prior, press = material.options.place_prior, material.session.press
    found = np.zeros((len(rows), 2, len(errors)))
    for k, row in enumerate(rows.tolist()):
        own = press == row
        slopes = (model.refit.slopes.place[own] * prior).reshape(-1, PLACE)
        inverse = np.linalg.inv(slopes.T @ slopes + np.eye(PLACE))
        for law, error in enumerate(errors):
            found[k, :, law] = (prior * (inverse @ (slopes.T @ error[own].ravel())))[:2]
    return np.nan_to_num(found)


def _main(moves: FloatArray) -> FloatArray:
    """As few columns (R, 2, k) as say what those of all laws (R, 2, L) do."""
    flat = moves.reshape(2 * len(moves), moves.shape[2])
    length = np.linalg.norm(flat, axis=0)
    some = length > _LAWS * length.max(initial=0.0)
    left, size, _ = np.linalg.svd(flat[:, some] / length[some], full_matrices=False)
    main = left[:, size > _LAWS * size.max(initial=0.0)]
    return as_floats(main.reshape(len(moves), 2, main.shape[1]))
