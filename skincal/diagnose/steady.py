"""Where a press was, frame by frame, without the noise of its measured places.

A rig that tells the contact from joint angles has noise in the place of every frame, a tenth of a millimetre or more
that the skin does not feel, while a hand that gives way moves the contact a little as the force rises. So the places of
a press are taken to lie on a line over its force. A press whose places move smoothly off that line, such as one that
slides, is left as it was measured.
"""

from __future__ import annotations

import numpy as np

from skincal.model.arrays import FloatArray, IntArray

_FEWEST = 6
_SMOOTH = 0.25
"""Below this part of white noise the differences of neighbours are those of a motion."""


def steady_places(place_m: FloatArray, force_n: FloatArray, row: IntArray) -> FloatArray:
    """Places (M, 3) of frames as lines over force, press by press.

    Args:
        place_m: (M, 3) as measured [m], NaN where nothing touches.
        force_n: (M,) [N].
        row: (M,) row of the press of each frame, -1 at rest.
    """
    steady = place_m.copy()
    known = (row >= 0) & np.isfinite(place_m).all(axis=1) & np.isfinite(force_n)
    order = np.flatnonzero(known)[np.argsort(row[known], kind="stable")]
    for own in np.split(order, np.flatnonzero(np.diff(row[order])) + 1):
        if len(own) >= _FEWEST:
            steady[own] = _on_line(place_m[own], force_n[own])
    return steady


def _on_line(place_m: FloatArray, force_n: FloatArray) -> FloatArray:
    """Places (m, 3) of one press, in the order of time."""
    share = force_n / max(float(np.abs(force_n).max()), 1e-12)
    columns = np.stack([np.ones_like(share), share], axis=1)
    line = columns @ np.linalg.lstsq(columns, place_m, rcond=None)[0]
    left = place_m - line
    total = float((left**2).sum())
    if 0.5 * float((np.diff(left, axis=0) ** 2).sum()) < _SMOOTH * total:
        return place_m
    return line
