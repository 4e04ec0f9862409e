"""Sites: which presses of a dataset share one, and its contact history."""

from __future__ import annotations

import numpy as np

from skincal.dataset import Dataset
from skincal.effects import met_before
from skincal.fitting.types import Ints
from skincal.model.arrays import FloatArray
from skincal.prediction.touches import frame_presses, touching

SAME_SITE_M = 1e-4
"""Largest distance of two targets of one site [m]."""


def sites(dataset: Dataset) -> Ints:
    """Return the site of each press (P,): by equal targets, or by equal measured positions without targets."""
    presses = dataset.presses
    targets = [presses.column(f"target_{axis}_m") for axis in "xyz"]
    given = [t for t in targets if t is not None]
    points, meant = presses.position_m, np.zeros(len(presses), dtype=np.bool_)
    if len(given) == 3:
        target = np.stack(given, axis=1)
        meant = np.asarray(np.isfinite(target).all(axis=1))
        points = np.where(meant[:, None], target, points)
    cells = np.round(np.nan_to_num(points) / SAME_SITE_M).astype(np.int64)
    return (
        np.unique(np.column_stack([meant, cells]), axis=0, return_inverse=True)[1].reshape(-1).astype(np.intp)
    )


def met_forces(dataset: Dataset, rows: Ints) -> FloatArray | None:
    """Return the largest force of earlier touches of the same site (M,) [N], by the holds of their presses.

    None if touches are not counted, or if no press has an earlier one at its site: without targets, measured positions
    mostly all differ.
    """
    cycle = _cycles(dataset)
    if cycle is None:
        return None
    order, met = _in_time(dataset), np.empty(len(cycle))
    met[order] = met_before(sites(dataset)[order], cycle[order], dataset.presses.force_n[order])
    return None if np.isnan(met[cycle > 0]).any() else met[rows]


def _cycles(dataset: Dataset) -> FloatArray | None:
    """Return the earlier touches of each press's site (P,), from its first frame if the table has no column."""
    own, frames = dataset.presses.column("cycle"), dataset.frames
    of_frames = None if frames is None else frames.column("cycle")
    if own is not None or of_frames is None:
        return own
    return _of_first_frames(dataset, of_frames)


def _in_time(dataset: Dataset) -> Ints:
    """Return the rows of presses in the order of their start, as far as it is recorded."""
    start = dataset.presses.column("t_start_s")
    if start is None or not np.isfinite(start).all():
        if dataset.frames is None:
            return np.arange(len(dataset.presses))
        start = _of_first_frames(dataset, dataset.frames.time_s)
    return np.argsort(start, kind="stable")


def _of_first_frames(dataset: Dataset, values: FloatArray) -> FloatArray:
    """Return the value, of values of frames (M,), in each press's first touching frame (P,); NaN without a frame."""
    touch = np.flatnonzero(touching(dataset))
    rows, first = np.unique(frame_presses(dataset)[touch], return_index=True)
    found = np.full(len(dataset.presses), np.nan)
    found[rows] = values[touch[first]]
    return found
