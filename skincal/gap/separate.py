"""How far further presses would set two explanations apart, and which of them do most.

Both explanations are fitted to the presses there are; the first leaves d_0² less of the squared residual than the
second. On further presses the *first* is taken to be true. The second may change all its numbers there, those of the
sensor included, by some delta, which costs delta' H delta on the old presses, at whose optimum it is. With places and
forces of the new presses integrated out, press k contributes

    |c_k - A_k delta|² = q_k - 2 b_k' delta + delta' N_k delta

with c what the first says beyond the second, A the slopes of the second, both whitened, and with all presses

    d² = d_0² + q - b' (H + N)^-1 b,        q, b, N: sums over the new presses.

Presses are chosen one by one, each the one that lifts the distances of all pairs most: the sum of logarithms of d².
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from skincal.gap.free import priors
from skincal.gap.hypothesis import PLACE
from skincal.gap.models import Model
from skincal.gap.problem import BASE_SIZE, RefitOptions
from skincal.gap.reading import Reading
from skincal.gap.refit import Refit, refit
from skincal.inference.session import GapSession
from skincal.model.arrays import BoolArray, FloatArray, IntArray, as_floats

_RIDGE = 1e-9
_LEAST = 1.0
"""Squared distances below this are no distance: the first presses count by how much they go beyond it."""


@dataclass(frozen=True, eq=False)
class Contest:
    """Two explanations on presses that may be made.

    Attributes:
        first: name of the effect that is taken to be there.
        second: name of the other.
        now: squared distance on the presses there are.
        normal: (n, n) what the presses there are know of the second's numbers.
        prior: (n, n) what is known of them without any press.
        grams: (P, 1 + n, 1 + n) q, b and N of each press.
        bare: (P, 1 + m, 1 + m) the same of what the first does beyond having no such effect, with the m numbers that
            both have.
    """

    first: str
    second: str
    now: float
    normal: FloatArray
    prior: FloatArray
    grams: FloatArray
    bare: FloatArray

    def __len__(self) -> int:
        return len(self.grams)

    def added(self, picked: BoolArray | None = None) -> float:
        """Squared distance with presses that are picked (P,), or all of them, added to those there are."""
        return self.now + float(_left(self._sum(self.grams, picked), self.normal))

    def alone(self, picked: BoolArray | None = None) -> float:
        """Squared distance on the picked presses alone."""
        return float(_left(self._sum(self.grams, picked), self.prior))

    def unlike(self, picked: BoolArray | None = None) -> float:
        """The part of what the first effect does on the picked presses alone that the second cannot imitate."""
        shared = self.bare.shape[-1] - 1
        whole = float(_left(self._sum(self.bare, picked), np.zeros((shared, shared))))
        return min(1.0, self.alone(picked) / whole) if whole > 0 else 0.0

    def _sum(self, grams: FloatArray, picked: BoolArray | None) -> FloatArray:
        return as_floats((grams if picked is None else grams[picked]).sum(axis=0))


def contest(
    names: tuple[str, str],
    models: tuple[Model, Model],
    now: float,
    session: GapSession,
    reading: Reading,
    options: RefitOptions,
) -> Contest:
    """Two explanations on presses that may be made.

    Args:
        names: of the effect that is taken to be there, and of the other.
        models: with the one, and with the other, both fitted to the presses there are.
        now: squared distance there.
        session: the presses that may be made.
        reading: their noise; its counts are not looked at.
        options: priors of places and forces.
    """
    first, second = models
    true = first.hypothesis.with_places(np.zeros((session.presses, PLACE)))
    values = true.values(session)
    others = {name: own for name, own in true.effects.items() if name != names[0]}
    here = _about(second, session, reading, options)
    change, weight = values - here.slopes.values, reading.weight(values)
    lacks = values - true.with_effects(others).values(session)
    columns = np.concatenate([here.slopes.base, here.slopes.effect], axis=-1)
    shared = np.array([True] * BASE_SIZE + [c.effect != names[1] for c in second.coords])
    owner = owners(session)
    place = here.slopes.place * options.place_prior
    normal = as_floats(np.linalg.pinv(second.refit.covariance, hermitian=True))
    prior: FloatArray = np.zeros(normal.shape)
    if second.coords:
        prior[BASE_SIZE:, BASE_SIZE:] = np.diag(1 / priors(second.coords) ** 2)

    def grams(of: FloatArray, by: FloatArray) -> FloatArray:
        return press_grams(np.nan_to_num(of * weight)[..., None], by, place, owner)

    return Contest(
        *names,
        now,
        normal,
        prior,
        grams(change, columns),
        grams(lacks, columns[..., shared]),
    )


def _about(model: Model, session: GapSession, reading: Reading, options: RefitOptions) -> Refit:
    """Values and slopes of a model on other presses, each where it was aimed at."""
    start = model.hypothesis.with_places(np.zeros((session.presses, PLACE)))
    still = replace(options, steps=0)
    return refit(start, session, reading, still, model.coords, model.refit.x, fixed=model.held)


def owners(session: GapSession) -> IntArray:
    """(N,) row of the press that each observation goes with: at rest the one before, or the first."""
    last = np.maximum.accumulate(np.where(session.press >= 0, np.arange(len(session)), -1))
    return session.press[np.where(last >= 0, last, int(np.argmax(session.press >= 0)))]


def press_grams(change: FloatArray, columns: FloatArray, place: FloatArray, owner: IntArray) -> FloatArray:
    """Inner products (P, 1 + n, 1 + n) of a change and of columns, press by press, with places integrated out.

    Args:
        change: (N, J, 1) whitened.
        columns: (N, J, n) whitened.
        place: (N, J, 3) whitened slopes by place and force of the own press, times their priors; zero at rest.
        owner: (N,) press of each observation.
    """
    both = np.concatenate([change, columns], axis=-1)
    found: list[FloatArray] = []
    for row in range(int(owner.max(initial=-1)) + 1):
        own = both[owner == row].reshape(-1, both.shape[-1])
        moved = place[owner == row].reshape(-1, place.shape[-1])
        cross = moved.T @ own
        inner = np.eye(moved.shape[1]) + moved.T @ moved
        found.append(own.T @ own - cross.T @ np.linalg.solve(inner, cross))
    return np.stack(found) if found else np.zeros((0, both.shape[-1], both.shape[-1]))


def _left(gram: FloatArray, known: FloatArray) -> FloatArray:
    """What is left of q in grams (..., 1 + n, 1 + n) when the second takes up what it can: q - b' (H + N)^-1 b."""
    normal, pull = known + gram[..., 1:, 1:], gram[..., 1:, :1]
    size = np.sqrt(np.maximum(np.einsum("...ii->...i", normal), 1e-300))
    scaled: FloatArray = normal / size[..., :, None] / size[..., None, :] + _RIDGE * np.eye(normal.shape[-1])
    taken = pull / size[..., :, None]
    inverse = as_floats(np.linalg.inv(scaled))
    fall = as_floats(np.einsum("...ik,...ij,...jk->...", taken, inverse, taken))
    return as_floats(np.maximum(gram[..., 0, 0] - fall, 0.0))


def pick(contests: Sequence[Contest], count: int) -> IntArray:
    """Presses that set explanations apart, in the order of what they add.

    Args:
        contests: pairs, all on the same presses.
        count: how many are picked at most.
    """
    presses = len(contests[0])
    sums = [np.zeros_like(c.grams[0]) for c in contests]
    order: list[int] = []
    free = np.ones(presses, dtype=np.bool_)
    for _ in range(min(count, presses)):
        worth = np.zeros(presses)
        for one, total in zip(contests, sums, strict=True):
            worth += np.log(_LEAST + one.now + _left(total + one.grams, one.normal))
        best = int(np.argmax(np.where(free, worth, -np.inf)))
        order.append(best)
        free[best] = False
        sums = [total + one.grams[best] for one, total in zip(contests, sums, strict=True)]
    return np.array(order, dtype=np.int64)
