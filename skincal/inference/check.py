"""Posterior predictive check: the squares that a model leaves, to be compared with those of null sessions."""

from __future__ import annotations

import numpy as np

from skincal.model.arrays import FloatArray, IntArray


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
