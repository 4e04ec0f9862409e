"""The one score: what a model says of presses that its fit has not seen, press by press, as a logarithm of likelihood.

Everything that a press has for itself is integrated out, so a press is its ``H_p`` and ``b_p``; the parameters that all
presses share are those of the other presses. Two models are compared by the sum of differences and its standard error.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skincal.inference.blocks import Blocks
from skincal.inference.constants import CONSTANTS as C
from skincal.model.arrays import FloatArray, IntArray


def folds_of(blocks: Blocks, rng: np.random.Generator) -> IntArray:
    """(B,) part of each block: presses by chance, stretches of rest in turn."""
    presses = blocks.press >= 0
    out = np.arange(len(presses)) % C.folds
    out[presses] = rng.permutation(np.arange(int(presses.sum())) % C.folds)
    return out


def held_out(
    h: FloatArray, b: FloatArray, prior: FloatArray, pull: FloatArray, folds: IntArray
) -> FloatArray:
    """(B, S) logarithm of the likelihood that blocks gain by a step of parameters found on the other folds.

    Args:
        h: (B, n, n).
        b: (B, n, S), of S sessions with the same columns.
        prior: (n,) precisions.
        pull: (n,) slope of the prior.
        folds: (B,).
    """
    out = np.zeros((len(b), b.shape[2]))
    total_h, total_b = h.sum(axis=0) + np.diag(prior), b.sum(axis=0) - pull[:, None]
    for fold in range(C.folds):
        test = folds == fold
        hh = total_h - h[test].sum(axis=0)
        size = 1 / np.sqrt(np.diag(hh))
        c = (
            np.linalg.solve(hh * np.outer(size, size), (total_b - b[test].sum(axis=0)) * size[:, None])
            * size[:, None]
        )
        out[test] = np.einsum("pns,ns->ps", b[test], c) - 0.5 * np.einsum("ns,pns->ps", c, h[test] @ c)
    return out


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
