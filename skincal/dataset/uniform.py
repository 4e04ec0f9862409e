"""Uniform pressure: a chamber, written as a flat punch larger than the patch."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skincal.dataset.dataset import Dataset
from skincal.model import FlatPunch

UNIFORM = (
    "every press is a flat punch larger than the patch: such uniform pressure looks the same for every pose and every "
    "elasticity, so neither can be found from it. Press with an indenter smaller than the patch (a sphere of about one "
    "pitch in radius) at several places. The scale of each taxel can be found"
)
"""What uniform pressure tells, and what to do."""


def uniform_pressure(dataset: Dataset) -> bool:
    """Whether every press loads all taxels alike, wherever it is: a flat punch larger than the patch."""
    if dataset.meta.indenter.kind != "flat":
        return False
    radii = np.unique(dataset.indenter_radii_m())
    known = radii[np.isfinite(radii)]
    punches = [dataset.indenter(float(r)) for r in known] if len(known) else [dataset.indenter()]
    half = float(np.hypot(*np.abs(dataset.layout().bounds_m).max(axis=0)))
    return all(isinstance(one, FlatPunch) and one.radius_m > half for one in punches)


def notes_on(dataset: Dataset) -> tuple[str, ...]:
    """What the data are not good for, though nothing is wrong with them."""
    return (f"{UNIFORM}.",) if uniform_pressure(dataset) else ()


def at_centre(dataset: Dataset) -> Dataset:
    """The dataset of a chamber with every contact whose place is not known at the sensor's nominal centre."""
    centre = dataset.surface().wrap(dataset.nominal_pose(), np.zeros((1, 2)))[0][0]

    def placed(points: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> np.ndarray:
        return np.where(np.isfinite(points), points, centre)

    presses = replace(dataset.presses, position_m=placed(dataset.presses.position_m))
    frames = dataset.frames
    if frames is not None:
        frames = replace(frames, position_m=placed(frames.position_m))
    return replace(dataset, presses=presses, frames=frames)
