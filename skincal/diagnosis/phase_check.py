"""Check that the frames of a dataset say when its presses were in contact."""

from __future__ import annotations

import numpy as np

from skincal.dataset import Dataset
from skincal.dataset.refusal import refusal
from skincal.diagnosis.dataset_session import press_rows


def check_phases(dataset: Dataset, fewest: int) -> None:
    """Refuse frames that mark too few presses as contact, or locate too few, although the press table has enough.

    Args:
        dataset: the session.
        fewest: number of presses required.

    Raises:
        WorkError: the table has ``fewest`` presses with a position and a force, and the frames have not.
    """
    table = dataset.presses
    located = int((np.isfinite(table.position_m).all(axis=1) & (table.force_n > 0)).sum())
    if dataset.frames is None or located < fewest:
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
