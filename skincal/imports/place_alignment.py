"""The offset of a file that holds positions alone, estimated by where the images lie. Pure numerics.

Positions do not follow the force, so the correlation of :mod:`skincal.imports.alignment` tells nothing of them. But
while something touches, the centre of the image is a linear function of the contact point, as far as a small patch is
flat. At the right lag this regression explains the positions. An indenter is in place before it touches and leaves
after that, so lags within such a rest are equally good: the offset is the middle of them, and their width its
uncertainty.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from skincal.imports import alignment
from skincal.imports.recording import FloatArray

TOUCHED: Final = 0.25
"""Something touches where the activity is more than this part of its largest (set by eye)."""


def estimate_offset_by_place(
    name: str,
    taxels_s: FloatArray,
    images: FloatArray,
    centres_m: FloatArray,
    file_s: FloatArray,
    columns: Mapping[str, FloatArray],
    within_s: float = np.inf,
) -> alignment.JoinedClock:
    """Return the estimated alignment of the clock of a file with positions.

    Arguments as :func:`~skincal.imports.alignment.estimate_offset`; ``columns`` holds positions, and ``centres_m`` the
    centres of the taxels in the patch [m], shape (J, 2).

    Raises:
        NoOffsetError: at no lag the images lie where the positions are, or several lags are equally good.
    """
    given = np.isfinite(list(columns.values())).all(axis=0)
    moving = {
        key: column
        for key, (_, column) in alignment.varying({k: c[given] for k, c in columns.items()}).items()
    }
    if not moving:
        raise alignment.NoOffsetError(
            "no lag at which the positions go with the images (nothing in them changes)"
        )
    file_s = file_s[given]
    zeros = float(taxels_s[0]), float(file_s[0])
    apart = zeros[0] - zeros[1]
    ours, theirs = taxels_s - zeros[0], file_s - zeros[1]
    step = alignment.common_step(ours, theirs)
    time, basis = _basis(ours, images, centres_m, step)
    their_time: FloatArray = np.arange(0.0, float(theirs[-1]) + step / 2, step)
    places: FloatArray = np.stack([np.interp(their_time, theirs, column) for column in moving.values()])
    explained = _explained(basis, places)
    lags: FloatArray = np.arange(1.0 - len(their_time), len(explained) - len(their_time) + 0.5) * step
    explained[np.abs(lags + apart) > within_s] = np.nan
    found: FloatArray = np.sqrt(np.maximum(explained, 0.0))
    if (peak := np.nanmax(found, initial=0.0)) < alignment.LEAST_CORRELATION:
        reached = f"a correlation of {peak:.2f} at most"
        raise alignment.NoOffsetError(
            f"no lag at which {', '.join(moving)} go with where the images lie ({reached})"
        )
    at = alignment.best_lag(lags + apart, found)
    # Lags that are as good as the best.
    first, last = alignment.stretch_about(
        1.0 - np.nan_to_num(explained) <= alignment.ALIKE * (1.0 - explained[at]) + 1e-12, at
    )
    offset = float(lags[first] + lags[last]) / 2
    sigma = float(np.hypot(lags[last] - lags[first], step)) / np.sqrt(12)
    near = np.abs(lags - offset) < 10 * max(step, time[-1] / 100)
    there: FloatArray = np.asarray(np.interp(time - offset, their_time, places[0]), dtype=np.float64)
    touched = np.flatnonzero((basis[0] > 0) & (time >= offset) & (time <= offset + their_time[-1]))
    some = touched[:: max(1, len(touched) // 2000)]
    fitted: FloatArray = basis[:, some].T @ (basis[:, touched] @ there[touched])
    return alignment.JoinedClock(
        name, offset + apart, sigma, estimated=True, by=next(iter(moving)), correlation=float(found[at]),
        lags_s=lags[near] + apart, correlations=np.nan_to_num(found[near]), time_s=time[some] + zeros[0],
        traces=np.stack([alignment.relative(fitted), alignment.relative(there[some])]),
    )  # fmt: skip


def _basis(
    ours: FloatArray, images: FloatArray, centres_m: FloatArray, step: float
) -> tuple[FloatArray, FloatArray]:
    """Return an even grid of times (m,), and on it an orthonormal basis (3, m) of 1 and the images' centres.

    Rows are zero where nothing touches.
    """
    read = np.isfinite(images).any(axis=0)
    images, centres = images[:, read], centres_m[read]
    apart = np.abs(np.nan_to_num(images - np.nanmedian(images, axis=0)))
    activity: FloatArray = np.asarray(apart.sum(axis=1), dtype=np.float64)
    touched = activity > TOUCHED * float(np.max(activity, initial=0.0))
    centre: FloatArray = apart @ (centres - centres.mean(axis=0)) / np.maximum(activity, 1e-300)[:, None]
    time: FloatArray = np.arange(0.0, float(ours[-1]) + step / 2, step)
    inside = np.interp(time, ours, touched.astype(np.float64)) > 0.5
    across: FloatArray = np.interp(time, ours, centre[:, 0])
    along: FloatArray = np.interp(time, ours, centre[:, 1])
    columns: FloatArray = np.column_stack([np.ones(len(time)), across, along])[inside]
    basis = np.zeros((3, len(time)))
    if inside.any():
        columns[:, 1:] -= columns[:, 1:].mean(axis=0)
        size = np.linalg.norm(columns, axis=0)
        basis[:, inside] = np.linalg.qr(columns / np.where(size > 0, size, 1.0))[0].T
        basis[0] = np.abs(basis[0])
    return time, basis


def _explained(basis: FloatArray, places: FloatArray) -> FloatArray:
    """Return the part of the positions' variance that the basis explains, by lag; NaN for a short overlap."""
    touched = (basis[0] > 0).astype(np.float64)
    count = np.rint(alignment.convolved(touched, np.ones_like(places[0])))
    total, left = np.zeros(len(count)), np.zeros(len(count))
    for place in places:
        column = ((place - place.mean()) / place.std())[::-1]
        mean = alignment.convolved(touched, column) / np.maximum(count, 1.0)
        total += alignment.convolved(touched, column**2) - count * mean**2
        left += alignment.convolved(basis[1], column) ** 2 + alignment.convolved(basis[2], column) ** 2
    good = (count >= alignment.LEAST_OVERLAP * touched.sum()) & (total > 1e-3 * count * len(places))
    # The basis is orthonormal over the whole recording, and nearly so over a part of it.
    return np.minimum(np.divide(left, total, out=np.full(len(total), np.nan), where=good), 1.0)
