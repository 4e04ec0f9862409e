"""The presses of a fit: which were used, where they lie on the patch, which to show, and what outliers look like."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skincal.dataset import Dataset
from skincal.dataset.placement import patch_coordinates
from skincal.fitting.problem import USED
from skincal.fitting.result import FitResult
from skincal.fitting.types import Floats
from skincal.model import Contacts, Converter, Patch, SensorPose, Skin, SkinParameters
from skincal.model.arrays import IntArray
from skincal.prediction import Seen, best_places

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


@dataclass(frozen=True, eq=False)
class LeftOut:
    """A press that was left out, though enough taxels were active.

    Attributes:
        row: its row in the table of presses.
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
    return sorted(_simulated(result, dataset, rows), key=lambda press: -press.rmse_counts)


def _simulated(result: FitResult, dataset: Dataset, rows: NDArray[np.intp]) -> Iterator[LeftOut]:
    if len(rows) == 0:
        return
    problem, rig = result.problem, result.problem.rig
    scale = np.broadcast_to(result.best["scale_per_n"], (rig.layout.taxels,))
    if result.scale_per_taxel_per_n is not None:
        scale = result.scale_per_taxel_per_n
    parameters = SkinParameters(result.best["elasticity_pa_per_m"], np.asarray(scale, dtype=np.float64))
    skin = Skin(Patch.build(rig.surface, rig.layout, best_pose(result)), parameters, Converter.none())
    points, radii = rig.surface.project(dataset.presses.position_m[rows]), dataset.indenter_radii_m()
    seen = problem.observed
    for point, row in zip(points, rows, strict=True):
        indenter, force = dataset.indenter(float(radii[row])), dataset.presses.force_n[row]

        tilted = None if dataset.presses.normals is None else dataset.presses.normals[row]
        # Measured normals are unit vectors only to the digits of the file.
        normal = tilted / np.linalg.norm(tilted) if tilted is not None and np.isfinite(tilted).all() else None

        def simulate(
            slack_m: Floats,
            _: Any,
            at: Any = point,
            force: Any = force,
            by: Any = indenter,
            up: Any = normal,
        ) -> Any:
            moved = rig.surface.offset(np.tile(at, (len(slack_m), 1)), slack_m[:, 0], slack_m[:, 1])
            normals = rig.surface.normal_at(moved) if up is None else np.tile(up, (len(moved), 1))
            return skin.values(by, Contacts(moved, normals, np.full(len(moved), force)))

        read = np.isfinite(seen.values[row]) & ~result.dead_taxels
        observed = np.where(read, seen.values[row], np.nan)
        image = Seen(
            np.nan_to_num(observed)[None],
            np.where(read, seen.slope[row], 0.0)[None],
            seen.saturated[row][None] & read,
            (np.nan_to_num(observed) > 1.0)[None],
            result.sigmas.noise_counts,
        )
        slack = rig.slack_m if np.isfinite(rig.slack_m) else 0.0
        place = best_places(simulate, image, rig.position_sigma_m, slack)
        simulated = simulate(place.slack_m, np.zeros(1, dtype=np.intp))[0]
        rmse = float(np.sqrt(np.mean((simulated - observed)[read] ** 2)))
        yield LeftOut(int(row), observed, simulated, rmse)
