"""Whether a model leaves more than chance: squares of presses, against the same in null sessions."""

from __future__ import annotations

import numpy as np

from skincal.model.arrays import FloatArray, IntArray

LEFT = ("middle of the presses", "worst presses", "rest")


def left(chi: FloatArray, count: IntArray, press: IntArray) -> FloatArray:
    """(S, 3) squares over the noise: the trimmed mean over presses, their 95 % quantile, the worst stretch of rest.

    Args:
        chi: (B, S) squares of blocks.
        count: (B,) values of each.
        press: (B,) -1 for rest.
    """
    each = chi / np.maximum(count, 1)[:, None]
    own, idle = np.sort(each[press >= 0], axis=0), each[press < 0]
    keep = max(int(0.9 * len(own)), 1)
    rest = idle.max(axis=0) if len(idle) else np.ones(chi.shape[1])
    return np.stack([own[:keep].mean(axis=0), np.quantile(own, 0.95, axis=0), rest], axis=1)
