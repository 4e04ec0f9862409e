"""Whether a dataset is of the sensor that a calibration stands for."""

from __future__ import annotations

import numpy as np

from skincal.calibration import Calibration
from skincal.dataset import Dataset
from skincal.errors import InputError, Problem

SAME_M = 1e-6
"""Lengths that differ by less are the same [m]."""


def check_same_sensor(calibration: Calibration, dataset: Dataset) -> None:
    """Checks that sensor and surface are the calibrated ones.

    Raises:
        InputError: they are not; says everything in which they differ.
    """
    ours, theirs = calibration.sensor, dataset.meta.sensor
    file = "dataset.toml" if dataset.folder is None else str(dataset.folder / "dataset.toml")
    fix = "Predict with a calibration of this sensor."
    found: list[Problem] = []
    if (ours.rows, ours.cols) != (theirs.rows, theirs.cols):
        expected = f"{ours.rows} x {ours.cols} taxels, as the calibration has"
        found.append(Problem(f"{file}, [sensor]", expected, f"{theirs.rows} x {theirs.cols}", fix))
    elif (off := _layout_difference(calibration, dataset)) > SAME_M:
        expected = "taxels where the calibration has them"
        found.append(Problem(f"{file}, [sensor]", expected, f"taxels up to {1e3 * off:.3g} mm off", fix))
    mine, other = calibration.surface, dataset.meta.surface
    if mine.kind != other.kind:
        found.append(
            Problem(f"{file}, [surface] kind", f'"{mine.kind}", as calibrated', f'"{other.kind}"', fix)
        )
    elif abs((mine.radius_m or 0.0) - (other.radius_m or 0.0)) > SAME_M:
        expected = f"{mine.radius_m:g} m, as calibrated"
        found.append(Problem(f"{file}, [surface] radius_m", expected, f"{other.radius_m:g} m", fix))
    elif mine.file and other.file and calibration.meshes.get(mine.file) != dataset.meshes.get(other.file):
        found.append(
            Problem(f"{file}, [surface] file", "the calibrated mesh", f"another one, {other.file}", fix)
        )
    if found:
        raise InputError(found)


def _layout_difference(calibration: Calibration, dataset: Dataset) -> float:
    one, other = calibration.layout(), dataset.layout()
    return float(
        max(np.abs(one.centres_m - other.centres_m).max(), np.abs(one.sizes_m - other.sizes_m).max())
    )
