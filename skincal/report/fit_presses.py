"""The presses of a fit: where they were measured on the patch, which to show, and what outliers look like."""

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

FEW = 30
"""Presses that are shown of a larger number."""

MOST = 8
"""Most presses that were left out to simulate; a larger number are not outliers."""


def measured_uv_m(result: FitResult, dataset: Dataset) -> Floats:
    """Return the measured contact positions (N, 2) on the patch at its best pose [m]; NaN where not measured."""
    rig, across_m = result.problem.rig, result.best["across_m"]
    radius_m = rig.arc_radius_m
    across = {"x_m": across_m} if radius_m is None else {"beta_rad": across_m / radius_m}
    pose = SensorPose(result.best["y_m"], result.best["alpha_rad"], **across)
    return patch_coordinates(rig.surface, pose, dataset.presses.position_m)


def why_unused(result: FitResult) -> list[tuple[str, int]]:
    """Return the reasons why presses were not used, with their numbers, the most frequent first."""
    return Counter(status for status in result.problem.status if status != USED).most_common()


def chosen_presses(rmse_counts: Floats, most: int) -> IntArray:
    """Return indices of the presses to show, the worst first: all up to ``most``, else :data:`FEW`.

    A third of the few are the worst, a sixth the best, the rest evenly from between. Errors are (K,) [counts].
    """
    order = np.argsort(-rmse_counts, kind="stable")
    count = len(order)
    if count <= most:
        return order
    worst, best = FEW // 3, FEW // 6
    between = np.linspace(worst, count - best - 1, FEW - worst - best).round().astype(np.int64)
    return order[np.concatenate([np.arange(worst), between, np.arange(count - best, count)])]


@dataclass(frozen=True, eq=False)
class ShownPress:
    """The images of a press.

    Attributes:
        row: of the press in the dataset.
        observed: (J,) observed values above rest; NaN where not read [counts].
        simulated: (J,) simulated values at the best position within its slack [counts].
        rmse_counts: root mean square difference over the taxels that were read [counts].
        mark: how it matches, in words.
        good: whether it matches.
    """

    row: int
    observed: Floats
    simulated: Floats
    rmse_counts: float
    mark: str
    good: bool = False


def used_presses(result: FitResult, chosen: IntArray) -> list[ShownPress]:
    """Return some of the presses that were used, by their index among those."""
    problem, presses = result.problem, result.presses
    observed = np.where(problem.weight > 0, presses.observed, np.nan)
    found: list[ShownPress] = []
    for k in chosen.tolist():
        rmse, good = float(presses.rmse_counts[k]), bool(presses.good[k])
        mark = f"rmse {rmse:.2g}" if good else f"bad: rmse {rmse:.2g}"
        found.append(ShownPress(int(problem.rows[k]), observed[k], presses.simulated[k], rmse, mark, good))
    return found


def left_out(result: FitResult, dataset: Dataset) -> list[ShownPress]:
    """Return presses that were left out, though enough taxels were active: the worst first, at most ``MOST``."""
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
    simulated = Touches.of_presses(on, dataset).select(rows).moved(slack_m).values()
    rmse = np.sqrt(np.nanmean((simulated - values[rows]) ** 2, axis=1))
    found = [
        ShownPress(row, values[row], image, error, f"left out: rmse {error:.2g}")
        for row, image, error in zip(rows.tolist(), simulated, rmse.tolist(), strict=True)
    ]
    return sorted(found, key=lambda press: -press.rmse_counts)
