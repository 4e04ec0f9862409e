"""The one score: what a model says of presses that its fit has not seen, press by press, as a logarithm of likelihood.

Everything that a press has for itself is integrated out, so a press is its ``H_p`` and ``b_p``; the parameters that all
presses share are those of the other presses. Two models are compared by the sum of differences and its standard error.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skincal.inference.blocks import Blocks
from skincal.inference.constants import CONSTANTS as C
from skincal.model.arrays import FloatArray, IntArray, as_floats


def folds_of(blocks: Blocks, rng: np.random.Generator) -> IntArray:
    """(B,) part of each block: presses by chance, stretches of rest in turn."""
    presses = blocks.press >= 0
    out = np.arange(len(presses)) % C.folds
    out[presses] = rng.permutation(np.arange(int(presses.sum())) % C.folds)
    return out


def held_out(
    h: FloatArray, b: FloatArray, prior: FloatArray, pull: FloatArray, folds: IntArray
) -> FloatArray:
    """(B, S) logarithm of the likelihood that blocks gain by what the other folds say of parameters.

    All that the other folds leave open is integrated out: where they say N(c, A^-1), and g = b_p - H_p c, it is::

        b_p'c - c'H_p c / 2 + g'(A + H_p)^-1 g / 2 - log det(1 + A^-1 H_p) / 2

    So what one press alone shows is held against all that it might have been, not against one guess.

    Args:
        h: (B, n, n).
        b: (B, n, S), of S sessions with the same columns.
        prior: (n,) precisions.
        pull: (n,) slope of the prior.
        folds: (B,).
    """
    out = np.zeros((len(b), b.shape[2]))
    # In units of the diagonal: metres beside parts.
    unit = 1 / np.sqrt(np.diag(h.sum(axis=0)) + prior)
    h, b, prior, pull = h * np.outer(unit, unit), b * unit[:, None], prior * unit**2, pull * unit
    total_h, total_b = h.sum(axis=0) + np.diag(prior), b.sum(axis=0) - pull[:, None]
    for fold in range(C.folds):
        test = folds == fold
        others = total_h - h[test].sum(axis=0)
        c = np.linalg.solve(others, total_b - b[test].sum(axis=0))
        out[test] = log_predictive(others, c, h[test], b[test])
    return out


def log_predictive(others: FloatArray, c: FloatArray, h: FloatArray, b: FloatArray) -> FloatArray:
    """(..., S) what blocks (..., n, n) and (..., n, S) gain where others say N(c, A^-1), of (n, S) and A (n, n)."""
    does, both = h @ c, others + h
    left = b - does
    wide = np.linalg.slogdet(both)[1] - np.linalg.slogdet(others)[1]
    gained = (b - 0.5 * does) * c + 0.5 * left * np.linalg.solve(both, left)
    return as_floats(gained.sum(axis=-2) - 0.5 * wide[..., None])


@dataclass(frozen=True, eq=False)
class Score:
    """Differences of a pair of models over blocks.

    Attributes:
        each: (B,) nats.
    """

    each: FloatArray

    @property
    def total(self) -> float:
        """Nats."""
        return float(self.each.sum())

    @property
    def error(self) -> float:
        """Its standard error."""
        return float(self.each.std() * np.sqrt(len(self.each)))

    @property
    def sure(self) -> float:
        """Standard errors by which it is there, no block counting for more than ``clip``: none decides alone."""
        k = np.clip(self.each, -C.clip, C.clip)
        return float(k.sum() / (k.std() * np.sqrt(len(k)) + 1e-9))

    @property
    def lasting(self) -> float:
        """Nats without the ``few`` blocks that gain most."""
        return self.total - float(np.sort(self.each)[-C.few :].sum())

    @property
    def shared(self) -> float:
        """Nats, no block counting for more than ``clip``."""
        return float(np.clip(self.each, -C.clip, C.clip).sum())
