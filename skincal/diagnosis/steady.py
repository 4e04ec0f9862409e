"""Where a press was, frame by frame, without the noise of its measured places.

A rig that tells the contact from joint angles has noise in the place of every frame, a tenth of a millimetre or more
that the skin does not feel, while a hand that gives way moves the contact a little as the force rises. So the places of
a press are taken to lie on a line over its force; on another one in unloading, where friction in the joints leads the
contact back another way, and on curves, where the measured places show that. A press whose places move smoothly off
that path, such as one that slides, is left as it was measured.
"""

from __future__ import annotations

import numpy as np
from scipy.special import fdtri

from skincal.effects.samples import UNLOAD
from skincal.model.arrays import BoolArray, FloatArray, IntArray

_FEWEST = 6
_SMOOTH = 0.25
"""Below this part of white noise the differences of neighbours are those of a motion."""
_EXACT_M = 1e-9
"""Places less apart than this are the same."""
_SURE = 1e-3
"""A path is bent where straight ones would look so by chance so rarely."""


def steady_places(place_m: FloatArray, force_n: FloatArray, row: IntArray, phase: IntArray) -> FloatArray:
    """Places (M, 3) of frames as paths over force, press by press.

    Args:
        place_m: (M, 3) as measured [m], NaN where nothing touches.
        force_n: (M,) [N].
        row: (M,) row of the press of each frame, -1 at rest.
        phase: (M,) as of samples.
    """
    steady = place_m.copy()
    known = (row >= 0) & np.isfinite(place_m).all(axis=1) & np.isfinite(force_n)
    order = np.flatnonzero(known)[np.argsort(row[known], kind="stable")]
    for own in np.split(order, np.flatnonzero(np.diff(row[order])) + 1):
        if len(own) >= _FEWEST:
            steady[own] = _on_path(place_m[own], force_n[own], phase[own] == UNLOAD)
    return steady


def _on_path(place_m: FloatArray, force_n: FloatArray, back: BoolArray) -> FloatArray:
    """Places (m, 3) of one press, in the order of time; ``back`` says which are of unloading."""
    share = force_n / max(float(np.abs(force_n).max()), 1e-12)
    columns = np.stack([np.ones_like(share), share], axis=1)
    path = _fitted(columns, place_m)
    for bend in ((1 - share) * back, share * (1 - share)):
        more = np.column_stack([columns, bend])
        other = _fitted(more, place_m)
        if _tells(place_m, path, other, len(place_m) - more.shape[1]):
            columns, path = more, other
    left = place_m - path
    total = float((left**2).sum())
    if 0.5 * float((np.diff(left, axis=0) ** 2).sum()) < _SMOOTH * total:
        return place_m
    return path


def _fitted(columns: FloatArray, place_m: FloatArray) -> FloatArray:
    return columns @ np.linalg.lstsq(columns, place_m, rcond=None)[0]


def _tells(place_m: FloatArray, path: FloatArray, other: FloatArray, free: int) -> bool:
    """Whether a path with one more column, ``free`` degrees of freedom left, is more than chance (F test)."""
    if free < _FEWEST:
        return False
    before, after = (float(((place_m - p) ** 2).sum()) for p in (path, other))
    if before - after <= _EXACT_M**2 * place_m.size:
        return False
    # Noise along a surface has two axes, that of a single joint hardly more than one.
    spread = np.linalg.eigvalsh((place_m - other).T @ (place_m - other))
    axes = float(spread.sum() ** 2 / max(float((spread**2).sum()), np.finfo(float).tiny))
    return (before - after) * free > after * float(fdtri(max(axes, 1.0), max(axes, 1.0) * free, 1 - _SURE))
