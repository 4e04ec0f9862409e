"""Frames that do not say when presses were in contact."""

from __future__ import annotations

import numpy as np

from skincal.dataset import Dataset
from skincal.dataset.refusal import refusal
from skincal.diagnosis.dataset_session import press_rows


def check_phases(dataset: Dataset, fewest: int) -> None:
    """Refuses frames of which too few are said to be in contact, or have a place, where the table has the presses.

    Args:
        dataset: the session.
        fewest: how many presses are needed.

    Raises:
        WorkError: the table has as many, with a place and a force, and the frames have not.
    """
    table = dataset.presses
    placed = int((np.isfinite(table.position_m).all(axis=1) & (table.force_n > 0)).sum())
    if dataset.frames is None or placed < fewest:
        return
    rows = press_rows(dataset)
    touched = len(np.unique(rows[rows >= 0]))
    wanted = "a press" if fewest == 1 else f"{fewest} presses"
    what = "columns x_m, y_m, z_m and force_n: expected a place and a force in"
    if touched < fewest:
        what = "columns press and phase: expected"
    else:
        known = np.isfinite(dataset.frames.position_m).all(axis=1) & np.isfinite(dataset.frames.force_n)
        touched = len(np.unique(rows[known & (rows >= 0)]))
        if touched >= fewest:
            return
    raise refusal(
        dataset,
        f"frames, {what} load, hold and unload frames of {wanted} at least; "
        f"got such frames of {touched} of {len(table)}. Correct them, or leave the frames out",
    )
