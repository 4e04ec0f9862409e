"""Scores of models: held-out log-likelihood of each press, gains of candidates, and misfit.

The nuisance parameters of a press (place, force, image error) are integrated out of its block, so that a block is its
``H_p`` and ``b_p``. The shared parameters come from the blocks of the other folds. Two models are compared by the sum
of the differences over blocks and its standard error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skincal.inference.blocks import Blocks
from skincal.inference.constants import CONSTANTS as C
from skincal.model.arrays import FloatArray, IntArray, as_floats


def folds_of(blocks: Blocks, rng: np.random.Generator) -> IntArray:
    """Draw the fold of each block (B,): presses at random, stretches of rest in turn."""
    presses = blocks.press >= 0
    out = np.arange(len(presses)) % C.folds
    out[presses] = rng.permutation(np.arange(int(presses.sum())) % C.folds)
    return out


def held_out(
    h: FloatArray, b: FloatArray, prior: FloatArray, pull: FloatArray, folds: IntArray
) -> FloatArray:
    """Compute the log-likelihood that each block gains from the parameters of the other folds.

    If the other folds give N(c, A^-1), and g = b_p - H_p c, the block's marginal log-likelihood is::

        b_p'c - c'H_p c / 2 + g'(A + H_p)^-1 g / 2 - log det(1 + A^-1 H_p) / 2

    The parameters are integrated over N(c, A^-1), not fixed at c: a parameter that only this block determines costs
    its whole prior width.

    Args:
        h: (B, n, n) curvatures.
        b: (B, n, S) slopes, of S sessions with the same columns.
        prior: (n,) precisions.
        pull: (n,) gradient of the prior at the fit: precision times the distance from its mean.
        folds: (B,) fold of each block.

    Returns:
        (B, S) [nats].
    """
    out = np.zeros((len(b), b.shape[2]))
    # In units of the diagonal: columns are in metres, radians and logarithms.
    unit = 1 / np.sqrt(np.diag(h.sum(axis=0)) + prior)
    h, b, prior, pull = h * np.outer(unit, unit), b * unit[:, None], prior * unit**2, pull * unit
    total_h, total_b = h.sum(axis=0) + np.diag(prior), b.sum(axis=0) - pull[:, None]
    for fold in range(C.folds):
        held = folds == fold
        others = total_h - h[held].sum(axis=0)
        c = np.linalg.solve(others, total_b - b[held].sum(axis=0))
        out[held] = log_predictive(others, c, h[held], b[held])
    return out


def log_predictive(others: FloatArray, c: FloatArray, h: FloatArray, b: FloatArray) -> FloatArray:
    """Compute the marginal log-likelihood of blocks under parameters N(c, A^-1) of the other folds.

    Args:
        others: (n, n) precision A.
        c: (n, S) mean.
        h: (..., n, n) curvatures of the blocks.
        b: (..., n, S) their slopes.

    Returns:
        (..., S) [nats].
    """
    explained, both = h @ c, others + h
    residual = b - explained
    log_widths = np.linalg.slogdet(both)[1] - np.linalg.slogdet(others)[1]
    gained = (b - 0.5 * explained) * c + 0.5 * residual * np.linalg.solve(both, residual)
    return as_floats(gained.sum(axis=-2) - 0.5 * log_widths[..., None])


@dataclass(frozen=True, eq=False)
class Score:
    """Difference of the scores of two models.

    Attributes:
        each: (B,) difference in each block [nats].
    """

    each: FloatArray

    @property
    def total(self) -> float:
        """Sum over blocks [nats]."""
        return float(self.each.sum())

    @property
    def error(self) -> float:
        """Standard error of the sum [nats]."""
        return float(self.each.std() * np.sqrt(len(self.each)))

    @property
    def significance(self) -> float:
        """Sum in standard errors, each block clipped at ``clip`` nats so that no block decides alone."""
        k = np.clip(self.each, -C.clip, C.clip)
        return float(k.sum() / (k.std() * np.sqrt(len(k)) + 1e-9))

    @property
    def without_best(self) -> float:
        """Sum without the ``few`` blocks that gain most [nats]."""
        return self.total - float(np.sort(self.each)[-C.few :].sum())

    @property
    def clipped(self) -> float:
        """Sum with each block clipped at ``clip`` nats [nats]."""
        return float(np.clip(self.each, -C.clip, C.clip).sum())


def misfit(chi: FloatArray, count: IntArray, press: IntArray) -> FloatArray:
    """Mean squared residuals over the noise: 1 is chance.

    Args:
        chi: (B, S) sums of squares of blocks, in S sessions.
        count: (B,) values in each block.
        press: (B,) press of each block, -1 for rest.

    Returns:
        (S, 3): mean over presses without the worst tenth, 95 % quantile of presses, worst block of rest.
    """
    each = chi / np.maximum(count, 1)[:, None]
    own, idle = np.sort(each[press >= 0], axis=0), each[press < 0]
    keep = max(int(0.9 * len(own)), 1)
    rest = idle.max(axis=0) if len(idle) else np.ones(chi.shape[1])
    return np.stack([own[:keep].mean(axis=0), np.quantile(own, 0.95, axis=0), rest], axis=1)


_CHUNK = 384
"""So many columns at once, or those of one candidate: a bound of the memory."""


def gains(
    blocks: Blocks,
    b: FloatArray,
    prior: FloatArray,
    pull: FloatArray,
    sigma: Sequence[FloatArray],
    folds: IntArray,
) -> list[FloatArray]:
    """Compute the gain (B, S) of each candidate, added to the model by itself, on held-out folds [nats].

    It equals :func:`held_out` with a candidate's columns, less that without. The model's own columns are eliminated
    once for all candidates, fold by fold: with ``W = H_mm^-1 H_mc`` and the model's own step ``c_m``, the step of a
    candidate is ``(H_cc - H_cm W)^-1 (b_c - H_cm c_m)``, and the model's step changes by ``-W`` times it. The columns
    of the held-out block are reduced in the same way.

    Args:
        blocks: of the model's columns, then those of the candidates one after the other.
        b: (B, n, S) slopes of S sessions.
        prior: (m,) precisions of the model's columns.
        pull: (m,) gradient of their prior at the fit: precision times the distance from its mean.
        sigma: prior standard deviations of the columns of each candidate.
        folds: (B,) fold of each block.
    """
    m = len(prior)
    own, product = np.arange(m), blocks.products
    model = product.between(own, own)
    total, total_b = model.sum(axis=0) + np.diag(prior), b.sum(axis=0)
    total_b[:m] -= pull[:, None]
    tests = [np.flatnonzero(folds == f) for f in range(C.folds)]
    others = [total - model[t].sum(axis=0) for t in tests]
    inverse = [_inverse(x) for x in others]
    with_own = {p: _inverse(x + model[p]) for x, t in zip(others, tests, strict=True) for p in t.tolist()}
    steps = [i @ (total_b[:m] - b[t, :m].sum(axis=0)) for i, t in zip(inverse, tests, strict=True)]
    out = [np.zeros((len(b), b.shape[2])) for _ in sigma]
    for which, columns in _chunks(sigma, m):
        size = columns.shape[1]
        flat = columns.ravel()
        cross = product.between(own, flat)
        each = np.stack([product.between(c, c) for c in columns], axis=1)
        precision = np.stack([np.diag(1 / sigma[w] ** 2) for w in which])
        for test, inv, step in zip(tests, inverse, steps, strict=True):
            seen = cross.sum(axis=0) - cross[test].sum(axis=0)
            follow = inv @ seen
            reduced = each.sum(axis=0) - each[test].sum(axis=0) + precision - _products(seen, follow, size)
            right = total_b[flat] - b[test][:, flat].sum(axis=0) - seen.T @ step
            unit = 1 / np.sqrt(np.diagonal(reduced, axis1=1, axis2=2))
            units = unit[:, :, None] * unit[:, None, :]
            reduced *= units
            c = np.linalg.solve(reduced, right.reshape(len(which), size, -1) * unit[..., None])
            for p in test.tolist():
                left = cross[p] - model[p] @ follow
                wide = with_own[p] @ left
                slope = b[p, flat] - follow.T @ b[p, :m] - left.T @ step
                slope -= wide.T @ (b[p, :m] - model[p] @ step)
                curve = each[p] - _products(follow, cross[p], size) - _products(left, follow + wide, size)
                gain = log_predictive(reduced, c, curve * units, slope.reshape(c.shape) * unit[..., None])
                for w, g in zip(which, gain, strict=True):
                    out[w][p] = g
    return out


def whole(blocks: Blocks, columns: IntArray) -> tuple[FloatArray, FloatArray]:
    """Return curvature (n, n) and slope (n,) of some columns, summed over blocks."""
    return blocks.products.whole.between(columns, columns)[0], blocks.b[:, columns].sum(axis=0)


def full_step(h: FloatArray, b: FloatArray, prior: FloatArray, pull: FloatArray) -> FloatArray:
    """Return the step (n,) for a curvature (n, n) and slope (n,), with the precision and slope (n,) of the prior."""
    return _inverse(h + np.diag(prior)) @ (b - pull)


def _inverse(h: FloatArray) -> FloatArray:
    """Invert a curvature, scaled by its diagonal: columns are in metres, radians and logarithms."""
    size = 1 / np.sqrt(np.diag(h))
    return np.linalg.inv(h * np.outer(size, size)) * np.outer(size, size)


def _products(one: FloatArray, other: FloatArray, size: int) -> FloatArray:
    """Multiply columns (m, candidates * size) within each candidate: (candidates, size, size)."""
    left, right = (x.T.reshape(-1, size, len(x)) for x in (one, other))
    return left @ right.swapaxes(1, 2)


def _chunks(sigma: Sequence[FloatArray], first: int) -> list[tuple[list[int], IntArray]]:
    """Group candidates with equally many columns: their indices, and their columns (candidates, size)."""
    begin = first + np.cumsum([0, *(len(s) for s in sigma)])
    by_size: dict[int, list[int]] = {}
    for w, s in enumerate(sigma):
        by_size.setdefault(len(s), []).append(w)
    out: list[tuple[list[int], IntArray]] = []
    for size, all_of_size in by_size.items():
        many = max(1, _CHUNK // size)
        for k in range(0, len(all_of_size), many):
            some = all_of_size[k : k + many]
            out.append((some, begin[some][:, None] + np.arange(size)))
    return out
