"""The presses of a fit: which were used, where they lie on the patch, and which to show."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skincal.dataset import Dataset
from skincal.dataset.placement import patch_coordinates
from skincal.fitting.problem import USED
from skincal.fitting.result import FitResult
from skincal.model import SensorPose

FloatArray = NDArray[np.floating[Any]]
IntArray = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class PressView:
    """All presses of the session (N) and the used ones (K), in patch coordinates of the best pose.

    Attributes:
        press: (N,) numbers of the presses.
        used: (K,) rows of the presses that were used.
        unused: (N - K,) rows of the others.
        measured_uv_m: (N, 2) measured contact positions [m]; NaN where not measured.
        estimated_uv_m: (K, 2) estimated contact positions [m].
    """

    press: IntArray
    used: IntArray
    unused: IntArray
    measured_uv_m: FloatArray
    estimated_uv_m: FloatArray

    @classmethod
    def of(cls, result: FitResult, dataset: Dataset) -> PressView:
        """Return the presses of a fit of a dataset."""
        rows = np.asarray(result.problem.rows, dtype=np.int64)
        surface = result.problem.rig.surface
        others = np.setdiff1d(np.arange(len(dataset.presses)), rows)
        return cls(
            dataset.presses.press,
            rows,
            others,
            patch_coordinates(surface, best_pose(result), dataset.presses.position_m),
            result.presses.uv_m,
        )


def best_pose(result: FitResult) -> SensorPose:
    """Return the best pose of the patch."""
    best, radius = result.best, result.problem.rig.arc_radius_m
    across = best["across_m"]
    if radius is not None:
        return SensorPose(best["y_m"], best["alpha_rad"], beta_rad=across / radius)
    return SensorPose(best["y_m"], best["alpha_rad"], x_m=across)


def why_unused(result: FitResult) -> list[tuple[str, int]]:
    """Return the reasons why presses were not used, with their numbers, the most frequent first."""
    return Counter(status for status in result.problem.status if status != USED).most_common()


def chosen_presses(rmse_counts: FloatArray, most: int, few: int = 30) -> IntArray:
    """Return the presses to show, the worst first: all of them, or a selection with the worst and best.

    Args:
        rmse_counts: (K,) error of each press [counts].
        most: largest number of which all are shown.
        few: else the number shown: a third are the worst, a sixth the best, the rest evenly from between.

    Returns:
        Indices of the presses.
    """
    order = np.argsort(-rmse_counts, kind="stable")
    count = len(order)
    if count <= most:
        return order
    worst, best = few // 3, few // 6
    between = np.linspace(worst, count - best - 1, few - worst - best).round().astype(np.int64)
    return order[np.concatenate([np.arange(worst), between, np.arange(count - best, count)])]
