"""Uniform pressure: a punch that presses on the whole patch at once, as a chamber does."""

from __future__ import annotations

import numpy as np

from skincal.dataset.dataset import Dataset

UNIFORM = (
    "every press is a flat punch larger than the patch: such uniform pressure looks the same for every pose and every "
    "elasticity, so neither can be found from it. Press with an indenter smaller than the patch (a sphere of about one "
    "pitch in radius) at several places. Per-taxel gains and everything that changes over time can still be seen in "
    "these data"
)
"""Why no fit is possible with uniform pressure, and what to do."""


def is_uniform(dataset: Dataset) -> bool:
    """Whether every press is a flat punch that covers the patch, however the patch is turned below it."""
    if dataset.meta.indenter.kind != "flat":
        return False
    half = float(np.hypot(*np.abs(dataset.layout().bounds_m).max(axis=0)))
    return bool((dataset.indenter_radii_m() > half).all())


def notes_on(dataset: Dataset) -> tuple[str, ...]:
    """What the data are not good for, though nothing is wrong with them."""
    return (f"no fit is possible: {UNIFORM}.",) if is_uniform(dataset) else ()
