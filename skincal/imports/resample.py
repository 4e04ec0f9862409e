"""Resampling of a stream on the clock of another. Pure numerics."""

from __future__ import annotations

import numpy as np

from skincal.imports.mapping_file import Resampling
from skincal.imports.recording import Column, FloatArray


def resampled(
    time_s: FloatArray, values: FloatArray, onto_s: FloatArray, resample: Resampling, max_age_s: float
) -> FloatArray:
    """Return a stream resampled at other times.

    ``previous`` takes the last sample that is not later; ``linear`` interpolates between the last and the next sample,
    and needs both. A sample older than ``max_age_s``, or two samples farther apart, give NaN.

    Args:
        time_s: the stream's times, ascending [s], shape (n,).
        values: its values, shape (n,).
        onto_s: times to resample at [s], shape (M,).
        resample: method.
        max_age_s: greatest age of a sample [s].

    Returns:
        Shape (M,); NaN where the stream has no valid sample.
    """
    if not len(time_s):
        return np.full(len(onto_s), np.nan)
    before = np.searchsorted(time_s, onto_s, side="right") - 1
    first = np.maximum(before, 0)
    if resample == "previous":
        return np.where((before >= 0) & (onto_s - time_s[first] <= max_age_s), values[first], np.nan)
    exact = (before >= 0) & (time_s[first] == onto_s)
    after = np.minimum(np.where(exact, first, before + 1), len(time_s) - 1)
    span = time_s[after] - time_s[first]
    good = (before >= 0) & (exact | ((before + 1 < len(time_s)) & (span <= max_age_s)))
    share = np.divide(onto_s - time_s[first], span, out=np.zeros(len(onto_s)), where=span > 0)
    return np.where(good, values[first] + share * (values[after] - values[first]), np.nan)


def resampled_words(time_s: FloatArray, words: Column, onto_s: FloatArray, max_age_s: float) -> Column:
    """Return the last word at other times, '' where it is too old; arguments as :func:`resampled`."""
    known, codes = np.unique(words.astype(str), return_inverse=True)
    found = resampled(time_s, codes.astype(np.float64), onto_s, "previous", max_age_s)
    return np.array([*known, ""], dtype=object)[np.where(np.isnan(found), -1, found).astype(np.intp)]
