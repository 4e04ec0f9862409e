"""The score of a model: the held-out log-likelihood of each press, nuisance parameters integrated out.

The nuisance parameters of a press (place, force, image error) are integrated out of its block, so that a block is its
``H_p`` and ``b_p``. The shared parameters come from the blocks of the other folds. Two models are compared by the sum
of the differences over blocks and its standard error.
"""

from __future__ import annotations

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
