"""Whether moves of presses go with something: groups of columns tried against presses that swap their moves.

Few numbers are seen where many would drown in chance, so that each group of columns that belong together is tried by
itself, and all together. With the share of the variance that a group explains, for the numbers that it has,

    share = 1 - |y - Z a - X b|² / (m - p) : |y - Z c|² / (m - z)

the best group is the one whose share is reached least often where presses swap what the nuisance Z leaves of their
moves (Freedman & Lane 1983). As the best of several it is compared with the best of as many in each of these
(Westfall & Young 1993), so that trying more of them is paid for. Others are added where they are as clear beside it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skincal.model.arrays import FloatArray, IntArray, as_floats

_SWAPS = 3999
"""The best of four groups can then be as rare as one in a thousand."""
_AT_ONCE = 500
_SAME = 1e-6
"""Columns less apart than this, relative, are one: offsets in all poses together are the sensor's pose."""
_FURTHER = 0.01
"""The p-value of a group that is added to others."""


@dataclass(frozen=True, eq=False)
class Explained:
    """What explains moves.

    Attributes:
        columns: indices of the columns that do.
        x: their numbers.
        share: of the variance of the moves, for the numbers that were free.
        p_value: of the best group being so good; others may have been added to it.
    """

    columns: IntArray
    x: FloatArray
    share: float
    p_value: float


def explained(
    moves: FloatArray,
    columns: FloatArray,
    nuisance: FloatArray,
    groups: Sequence[Sequence[int]],
    rng: np.random.Generator,
) -> Explained | None:
    """The columns that moves go with most clearly; None where no group does anything that the nuisance does not.

    Args:
        moves: (P, 2) of the presses.
        columns: (P, 2, n) moves by each number that may explain them.
        nuisance: (P, 2, z) moves by what is there in any case.
        groups: of columns that belong together.
        rng: swaps presses.
    """
    every = _usable(columns, nuisance, groups)
    if not every:
        return None
    tried = every if len(every) < 2 else [*every, np.concatenate(every)]
    best, chance = _best(moves, columns, nuisance, tried, rng)
    chosen = tried[best]
    left = [one for one in every if not np.isin(one, chosen).any()]
    while True:
        beside = np.concatenate([nuisance, columns[..., chosen]], axis=-1)
        left = _usable(columns, beside, left)
        if not left:
            break
        best, further = _best(moves, columns, beside, left, rng)
        if further > _FURTHER:
            break
        chosen = np.concatenate([chosen, left.pop(best)])
    share = largest_share(moves, columns, nuisance, [chosen])
    return Explained(chosen, numbers(moves, columns[..., chosen], nuisance), share, chance)


def largest_share(
    moves: FloatArray, columns: FloatArray, nuisance: FloatArray, groups: Sequence[Sequence[int] | IntArray]
) -> float:
    """The largest share of the variance that a group, or all together, explains; 0 where none can."""
    every = _usable(columns, nuisance, groups)
    if not every:
        return 0.0
    base = _orthonormal(_flat(nuisance))
    rest = _left(_flat(moves), base)
    return max(float(_shares(rest, columns, base, one)[0]) for one in [*every, np.concatenate(every)])


def numbers(moves: FloatArray, columns: FloatArray, nuisance: FloatArray) -> FloatArray:
    """The smallest numbers (n,) that explain most of the moves (P, 2); 0 of what the nuisance does as well."""
    base = _orthonormal(_flat(nuisance))
    own, size = _beside(_flat(columns), base)
    y = _left(_flat(moves), base)[:, 0]
    return as_floats(np.linalg.lstsq(own, y, rcond=_SAME)[0] / size)


def beyond(moves: FloatArray, nuisance: FloatArray) -> FloatArray:
    """Moves (P, 2) without what the nuisance explains."""
    return as_floats(_left(_flat(moves), _orthonormal(_flat(nuisance))).reshape(moves.shape))


def _usable(
    columns: FloatArray, nuisance: FloatArray, groups: Sequence[Sequence[int] | IntArray]
) -> list[IntArray]:
    """Groups that do anything that the nuisance does not."""
    base = _orthonormal(_flat(nuisance))
    every = [np.array(one, dtype=np.int64) for one in groups if len(one)]
    return [one for one in every if _beside(_flat(columns[..., one]), base)[0].any()]


def _best(
    moves: FloatArray,
    columns: FloatArray,
    nuisance: FloatArray,
    groups: Sequence[IntArray],
    rng: np.random.Generator,
) -> tuple[int, float]:
    """The group whose share is least often reached, and the p-value of the best one's being so good."""
    base = _orthonormal(_flat(nuisance))
    rest = beyond(moves, nuisance)
    shares = [np.array([_shares(_flat(rest), columns, base, one)[0] for one in groups])[:, None]]
    for begin in range(0, _SWAPS, _AT_ONCE):
        many = min(_AT_ONCE, _SWAPS - begin)
        order = rng.permuted(np.tile(np.arange(len(moves)), (many, 1)), axis=1)
        swapped = _left(rest[order].reshape(many, -1).T, base)
        shares.append(np.stack([_shares(swapped, columns, base, one) for one in groups]))
    table = as_floats(np.concatenate(shares, axis=1))
    # How often a share is reached, itself counted; the first column is what was seen.
    reached = np.empty(table.shape, dtype=np.int64)
    for own, row in zip(reached, table, strict=True):
        own[:] = len(row) - np.sort(row).searchsorted(row, "left")
    least = reached.min(axis=0)
    equal = np.flatnonzero(reached[:, 0] == least[0])
    # Of groups that are equally clear the one with the fewest columns: others can still be added.
    best = min(equal.tolist(), key=lambda k: (len(groups[k]), -table[k, 0]))
    return best, float((least <= least[0]).mean())


def _shares(moves: FloatArray, columns: FloatArray, base: FloatArray, chosen: IntArray) -> FloatArray:
    """Shares (B,) of the variance of moves (m, B), nuisance taken off, that columns explain."""
    own = _orthonormal(_beside(_flat(columns[..., chosen]), base)[0])
    free = len(moves) - base.shape[1]
    total = (moves**2).sum(axis=0)
    left = total - ((own.T @ moves) ** 2).sum(axis=0)
    inner = max(1, free - own.shape[1])
    return 1 - np.divide(left / inner, total / max(1, free), out=np.ones_like(total), where=total > 0)


def _flat(values: FloatArray) -> FloatArray:
    """(P, 2) or (P, 2, n) as (2 P, 1) or (2 P, n)."""
    return values.reshape(2 * len(values), values.shape[2] if values.ndim > 2 else 1)


def _beside(columns: FloatArray, base: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Columns (m, n) without what a basis spans, of unit length or 0 where nothing is left; and their lengths."""
    left = _left(columns, base)
    size, whole = np.linalg.norm(left, axis=0), np.linalg.norm(columns, axis=0)
    lost = size <= _SAME * whole
    size = np.where(lost, 1.0, size)
    return as_floats(np.where(lost, 0.0, left / size)), as_floats(size)


def _orthonormal(columns: FloatArray) -> FloatArray:
    """An orthonormal basis (m, r) of what columns (m, n) span."""
    left, size, _ = np.linalg.svd(columns, full_matrices=False)
    return as_floats(left[:, size > _SAME * size.max(initial=0.0)])


def _left(moves: FloatArray, base: FloatArray) -> FloatArray:
    """Columns (m, B) without what an orthonormal basis (m, r) spans."""
    return as_floats(moves - base @ (base.T @ moves))
