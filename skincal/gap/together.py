"""Numbers of effects that can be changed all at once, because each of them acts on its own taxel only.

A sensor of fifty taxels has fifty offsets, and a slope by each of them would run the whole session fifty times. As long
as no later stage mixes the values of taxels, one run with all offsets changed shows what each of them does.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from skincal.effects import EFFECTS, Stage
from skincal.gap.free import Coordinate
from skincal.model.arrays import FloatArray, IntArray


def together(coords: Sequence[Coordinate], beside: Iterable[str] = ()) -> list[list[int]]:
    """Positions of coordinates in groups that can be changed at once; most are a group of their own.

    Args:
        coords: numbers of effects.
        beside: names of other effects in the model.
    """
    mixes = any(EFFECTS[name].stage == Stage.CROSSTALK for name in {*beside, *(c.effect for c in coords)})
    groups: dict[object, list[int]] = {}
    for k, c in enumerate(coords):
        stage = EFFECTS[c.effect].stage
        local = stage == Stage.CONVERTER or (stage == Stage.TRANSFER and not mixes)
        alone = c.parameter.shape != "per-taxel" or not local
        groups.setdefault(k if alone else (c.effect, c.parameter.name), []).append(k)
    return list(groups.values())


def apart(
    change: FloatArray, coords: Sequence[Coordinate], steps: FloatArray, taxels: IntArray | None
) -> FloatArray:
    """Slopes (N, J, n) by each number of a group, from what all of them do at once.

    Args:
        change: (N, J) of the values.
        coords: the group, as of :func:`together`.
        steps: (n,) by how much each was changed.
        taxels: (J,) which of the layout's taxels are looked at; None for all of them.
    """
    if len(coords) == 1:
        return (change / steps[0])[..., None]
    found = np.zeros((*change.shape, len(coords)))
    for k, c in enumerate(coords):
        own = np.array([c.index]) if taxels is None else np.flatnonzero(taxels == c.index)
        found[:, own, k] = change[:, own] / steps[k]
    return found
