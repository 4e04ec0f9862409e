"""The presses of a fit: which were used, where they lie on the patch, which to show, and what outliers look like."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace

import numpy as np

from skincal.calibrate.assemble import calibration_of
from skincal.calibration import Provenance
from skincal.dataset import Dataset
from skincal.dataset.placement import patch_coordinates
from skincal.fitting.problem import USED
from skincal.fitting.result import FitResult
from skincal.fitting.types import Floats
from skincal.model import SensorPose
from skincal.model.arrays import IntArray
from skincal.prediction.holds import place_presses
from skincal.prediction.touches import CalibratedSkin, Touches

MOST = 8
"""Most presses that were left out to simulate; a larger number are not outliers."""


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
    measured_uv_m: Floats
    estimated_uv_m: Floats

    @classmethod
    def of(cls, result: FitResult, dataset: Dataset) -> PressView:
        """Return the presses of a fit of a dataset."""
        rows = np.asarray(result.problem.rows, dtype=np.int64)
        others = np.setdiff1d(np.arange(len(dataset.presses)), rows)
        surface, pose = result.problem.rig.surface, best_pose(result)
        measured = patch_coordinates(surface, pose, dataset.presses.position_m)
        return cls(dataset.presses.press, rows, others, measured, result.presses.uv_m)


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


def chosen_presses(rmse_counts: Floats, most: int, few: int = 30) -> IntArray:
    """Return indices of the presses to show, the worst first: all, or a selection with the worst and best.

    Args:
        rmse_counts: (K,) error of each press [counts].
        most: largest number of which all are shown.
        few: else the number shown: a third are the worst, a sixth the best, the rest evenly from between.
    """
    order = np.argsort(-rmse_counts, kind="stable")
    count = len(order)
    if count <= most:
        return order
    worst, best = few // 3, few // 6
    between = np.linspace(worst, count - best - 1, few - worst - best).round().astype(np.int64)
    return order[np.concatenate([np.arange(worst), between, np.arange(count - best, count)])]


@dataclass(frozen=True, eq=False)
class LeftOut:
    """A press that was left out, though enough taxels were active.

    Attributes:
        observed: (J,) observed values above rest; NaN where not read [counts].
        simulated: (J,) simulated values at the best position within its slack [counts].
        rmse_counts: root mean square difference over the taxels that were read [counts].
    """

    row: int
    observed: Floats
    simulated: Floats
    rmse_counts: float


def left_out(result: FitResult, dataset: Dataset) -> list[LeftOut]:
    """Return the presses that were left out, the worst first; at most ``MOST`` of them."""
    problem = result.problem
    least = int(problem.active[problem.rows].min(initial=len(problem.active)))
    known = np.isfinite(dataset.presses.position_m).all(axis=1) & (dataset.presses.force_n > 0)
    unused = np.array([status != USED for status in problem.status])
    rows = np.flatnonzero(unused & known & (problem.active >= least))[:MOST]
    if not len(rows):
        return []
    on = CalibratedSkin.of(calibration_of(result, dataset, Provenance("")), dataset)
    values = np.where(result.dead_taxels, np.nan, problem.observed.values)
    slack_m = place_presses(on, dataset, replace(problem.observed, values=values), rows).slack_m
    simulated = Touches.of_presses(on, dataset).taken(rows).moved(slack_m).values()
    rmse = np.sqrt(np.nanmean((simulated - values[rows]) ** 2, axis=1))
    found = [
        LeftOut(int(row), values[row], *own) for row, *own in zip(rows, simulated, rmse.tolist(), strict=True)
    ]
    return sorted(found, key=lambda press: -press.rmse_counts)
