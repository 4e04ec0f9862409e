"""Frames that do not say when presses were in contact."""

from __future__ import annotations

import numpy as np

from skincal.dataset import Dataset
from skincal.dataset.refusal import refusal


def check_phases(dataset: Dataset, presses: int, fewest: int) -> None:
    """Refuses frames of which too few are said to be in contact, where the table has the presses.

    Args:
        dataset: the session.
        presses: how many have frames in contact.
        fewest: how many are needed.

    Raises:
        WorkError: the table has as many, with a place and a force.
    """
    table = dataset.presses
    placed = int((np.isfinite(table.position_m).all(axis=1) & (table.force_n > 0)).sum())
    if dataset.frames is None or placed < fewest:
        return
    wanted = "a press" if fewest == 1 else f"{fewest} presses"
    raise refusal(
        dataset,
        f"frames, columns press and phase: expected load, hold and unload frames of {wanted} at least; "
        f"got such frames of {presses} of {len(table)}. Correct them, or leave the frames out",
    )
