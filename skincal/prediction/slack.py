"""The slack of a dataset's presses: their positions as estimated from their hold images."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from skincal.dataset import Dataset
from skincal.fitting.observe import Observed
from skincal.fitting.types import Floats, Ints
from skincal.prediction.holds import HoldModel, in_time
from skincal.prediction.places import ObservedImages, Places, Simulate, best_places
from skincal.prediction.touches import CalibratedSkin, Touches


def best_slack(
    on: CalibratedSkin, dataset: Dataset, seen: Observed, progress: Callable[[int, int], None]
) -> Floats:
    """Return the best slack of the presses (P, 2); a press of unknown position or without force stays."""
    progress(0, 1)
    known = np.isfinite(dataset.presses.position_m).all(axis=1) & (dataset.presses.force_n > 0)
    free = np.flatnonzero(known)
    slack = np.zeros((len(known), 2))
    if on.has_effects:
        free = in_time(dataset, free)
        found = _found(HoldModel.of(on, dataset, free).values, on, dataset, seen, free)
        slack[free] = found.slack_m
        if on.full.has_memory:
            # The influence of memory at the estimated positions differs slightly from that at the measured ones.
            again = HoldModel.of(on, dataset, free, slack)
            slack[free] = _found(again.values, on, dataset, seen, free, found).slack_m
    else:
        slack[free] = place_presses(on, dataset, seen, free).slack_m
    progress(1, 1)
    return slack


def place_presses(on: CalibratedSkin, dataset: Dataset, seen: Observed, rows: Ints) -> Places:
    """Return the best positions of presses ``rows`` (n,) of known position, on a skin without effects."""
    measured = Touches.of_presses(on, dataset).taken(rows)

    def simulate(slack_m: Floats, press: Ints) -> Floats:
        return measured.taken(press).moved(slack_m).values()

    return _found(simulate, on, dataset, seen, rows)


def _found(
    simulate: Simulate,
    on: CalibratedSkin,
    dataset: Dataset,
    seen: Observed,
    free: Ints,
    start: Places | None = None,
) -> Places:
    """Return the best positions of some presses (n,)."""
    read = np.isfinite(seen.values[free])
    scatter = seen.rest_sigma_counts if np.isfinite(seen.rest_sigma_counts) else 0.0
    values, weight = np.where(read, seen.values[free], 0.0), np.where(read, seen.slope[free], 0.0)
    lit = read & (values > max(4 * scatter, 0.5))
    images = ObservedImages(values, weight, seen.saturated[free] & read, lit, max(scatter, 0.05))
    spec = dataset.meta.position
    bound = spec.slack_m if np.isfinite(spec.slack_m) else _patch_size_m(on)
    return best_places(simulate, images, spec.sigma_m, bound, start)


def _patch_size_m(on: CalibratedSkin) -> float:
    """Return half of the patch's longer side: without a bound of the slack, a press still lies on the patch."""
    low, high = on.skin.patch.layout.bounds_m
    return float((high - low).max()) / 2
