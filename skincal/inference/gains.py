"""Held-out gains of many candidates at once, each added to the model by itself.

They equal :func:`skincal.inference.score.held_out` with a candidate's columns, less that without. The model's own
columns are eliminated once for all candidates, fold by fold: with ``W = H_mm^-1 H_mc`` and the model's own step
``c_m``, the step of a candidate is ``(H_cc - H_cm W)^-1 (b_c - H_cm c_m)``, and the model's step changes by ``-W``
times it. The columns of the held-out block are reduced in the same way.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from skincal.inference.blocks import Blocks
from skincal.inference.constants import CONSTANTS as C
from skincal.inference.score import log_predictive
from skincal.model.arrays import FloatArray, IntArray

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
    """Compute the gain (B, S) of each candidate on held-out folds [nats].

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
