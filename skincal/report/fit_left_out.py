"""Presses that a fit left out as outliers, with the images that the best skin would show."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skincal.dataset import Dataset
from skincal.fitting.problem import USED
from skincal.fitting.result import FitResult
from skincal.model import Contacts, Converter, Patch, Skin, SkinParameters
from skincal.prediction import Seen, best_places
from skincal.report.fit_presses import best_pose

FloatArray = NDArray[np.floating[Any]]

MOST = 8
"""Most presses to simulate; a larger number are not outliers."""


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
    observed: FloatArray
    simulated: FloatArray
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
            slack_m: FloatArray,
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
