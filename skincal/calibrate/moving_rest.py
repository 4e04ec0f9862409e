"""The finding of a level at rest that moves over a session."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from skincal.calibration import Calibration, Finding
from skincal.dataset import Dataset, rest_levels
from skincal.dataset.rest_drift import rest_drift

REST_MOVES: Final = "rest_moves"
"""Code of the finding."""

_MATTERS: Final = 0.005
"""Part of the largest signal from which it is told."""


def with_moving_rest(calibration: Calibration, dataset: Dataset) -> Calibration:
    """The calibration, with a note where the level at rest moves by enough to matter."""
    shifts = rest_drift(dataset)
    if shifts is None or not shifts.any():
        return calibration
    size = float(np.median(np.sqrt((shifts**2).mean(axis=0))))
    if not size > _MATTERS * np.nanmax(dataset.presses.counts - rest_levels(dataset)):
        return calibration
    sensor = dataset.meta.sensor
    finding = Finding(
        REST_MOVES,
        "info",
        f"The level at rest moves by {size:.3g} {sensor.unit or 'counts'} rms between presses: drift, perhaps with "
        "re-zeroing. Each press was fitted above the level right before it.",
        "Ranges do not contain this drift; `skincal diagnose` looks for a steady one (baseline_drift).",
    )
    return replace(calibration, findings=(*calibration.findings, finding))
