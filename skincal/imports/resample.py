"""Resampling of a stream on the clock of another. Pure numerics."""

from __future__ import annotations

import numpy as np

from skincal.imports.mapping import TopicRules
from skincal.imports.recording import FloatArray


def resampled(time_s: FloatArray, values: FloatArray, onto_s: FloatArray, rules: TopicRules) -> FloatArray:
    """Return a stream resampled at other times.

    ``previous`` takes the last sample that is not later; ``linear`` interpolates between the last and the next sample,
    and needs both. A sample older than ``max_age_s``, or two samples farther apart, give NaN.

    Args:
        time_s: the stream's times, ascending [s], shape (n,).
        values: its values, shape (n,).
        onto_s: times to resample at [s], shape (M,).
        rules: kind and greatest age.

    Returns:
        Shape (M,); NaN where the stream has no valid sample.
    """
    if not len(time_s):
        return np.full(len(onto_s), np.nan)
    before = np.searchsorted(time_s, onto_s, side="right") - 1
    first = np.maximum(before, 0)
    if rules.resample == "previous":
        good = (before >= 0) & (onto_s - time_s[first] <= rules.max_age_s)
        return np.where(good, values[first], np.nan)
    exact = (before >= 0) & (time_s[first] == onto_s)
    after = np.minimum(np.where(exact, first, before + 1), len(time_s) - 1)
    span = time_s[after] - time_s[first]
    good = (before >= 0) & (exact | ((before + 1 < len(time_s)) & (span <= rules.max_age_s)))
    share = np.divide(onto_s - time_s[first], span, out=np.zeros(len(onto_s)), where=span > 0)
    return np.where(good, values[first] + share * (values[after] - values[first]), np.nan)
