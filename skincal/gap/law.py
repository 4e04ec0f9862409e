"""In which directions the contact law may be wrong, so that they are not taken for an effect.

Twins under other laws (:mod:`skincal.gap.twin`) differ from the fitted one by residuals that sensor and places cannot
take up. Elastic layers of a millimetre and of ten leave residuals of very different lengths, but nearly all in the same
few directions. These are projected out of data, of null sessions and of what effects do alike: an effect is then seen
by what no contact law does, and one that does nothing else is not.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from skincal.gap.candidates import Scene
from skincal.model.arrays import BoolArray, FloatArray, as_floats

MOST = 4
"""Directions at most."""
_ENOUGH = 10.0
"""A law whose squared residual is no longer than this is as good as the fitted one: less than the unit of a score."""


def law_directions(scene: Scene, rows: BoolArray, errors: Sequence[FloatArray]) -> FloatArray:
    """The fewest directions (N, J, m), at most :data:`MOST`, beyond which no law leaves anything to speak of.

    Args:
        scene: of the base model's fit.
        rows: (N,) observations that are looked at.
        errors: (N, J) whitened residual of each law.
    """
    some = np.stack(errors, axis=-1)
    view = scene.part(rows)
    left = view.projection.apply(some[view.rows].reshape(-1, some.shape[-1]))
    _, lengths, turn = np.linalg.svd(left, full_matrices=False)
    parts = (lengths[:, None] * turn) ** 2
    beyond = [float(parts[m:].sum(axis=0).max(initial=0.0)) for m in range(min(MOST, len(lengths)) + 1)]
    many = next((m for m, most in enumerate(beyond) if most <= _ENOUGH), len(beyond) - 1)
    return as_floats(some @ turn[:many].T)
