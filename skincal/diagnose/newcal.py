"""A calibration with effects added: the new best parameters, and intervals that go with them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import replace
from math import degrees

import numpy as np

from skincal import __version__
from skincal.calibration import Calibration, Effect, Interval, ModelParameters
from skincal.calibration.parts import REST
from skincal.calibration.skin import effect_from
from skincal.dataset import Dataset
from skincal.effects import EFFECTS
from skincal.gap.free import Coordinate, parameters_at
from skincal.gap.hypothesis import Hypothesis, Parameters
from skincal.gap.problem import BASE_SIZE
from skincal.gap.refit import Refit
from skincal.model.arrays import FloatArray

_WIDTH = 1.96
_LOGARITHMIC = ("elasticity_pa_per_m", "scale_per_n")


def new_calibration(
    calibration: Calibration,
    found: Refit,
    coords: Sequence[Coordinate],
    held: Mapping[str, Parameters],
    mean_square: float,
    dataset: Dataset,
    poses: tuple[str, ...],
) -> Calibration:
    """The calibration that a refit with effects comes to.

    Intervals of the sensor keep the width of those they come from, about the new best values: what an interval covers
    beside noise, such as another contact law, the effects do not take away. Intervals of effects are those of the
    refit, 95 %, wider where the model fits worse than noise.

    Args:
        calibration: that it comes from.
        found: sensor and effects.
        coords: numbers of the effects.
        held: parameters that were held.
        mean_square: of the whitened residual.
        dataset: names the data.
        poses: names of the hand poses.
    """
    model = parameters_of(calibration, found.hypothesis)
    before, after = calibration.model.best(), model.best()
    intervals = {
        name: _moved(name, interval, before[name], after[name])
        for name, interval in calibration.intervals.items()
        if name in after
    }
    if REST in calibration.intervals:
        intervals[REST] = calibration.intervals[REST]
    draws = calibration.draws
    if draws is not None:
        draws = {
            name: _shifted(name, column, before[name], after[name]) if name in after else column
            for name, column in draws.items()
        }
    from_, name = calibration.provenance, _label(dataset)
    before_ = {"calibrated_on": from_.dataset, "calibrated_on_sha256": from_.dataset_sha256}
    provenance = replace(
        from_,
        dataset=name or from_.dataset,
        dataset_sha256=dataset.sha256 or from_.dataset_sha256,
        version=__version__,
        extra={**from_.extra, **before_, "diagnosed": name},
    )
    had = {e.name for e in calibration.effects}
    effects = _effects(found, coords, held, mean_square, dataset, poses, had)
    kept = tuple(e for e in calibration.effects if e.name not in {one.name for one in effects})
    return replace(
        calibration,
        model=model,
        intervals=intervals,
        draws=draws,
        effects=(*kept, *effects),
        provenance=provenance,
        grid=None,
        folder=None,
    )


def _label(dataset: Dataset) -> str:
    return "" if dataset.folder is None else dataset.folder.resolve().name


def parameters_of(calibration: Calibration, hypothesis: Hypothesis) -> ModelParameters:
    """The best parameters of a calibration as a hypothesis has them."""
    model, pose = hypothesis.model, hypothesis.model.pose
    scale = model.scale_per_n
    each = None if isinstance(scale, float | int) else tuple(float(s) for s in np.atleast_1d(scale))
    old = calibration.model
    common = old.scale_per_n
    if each is None:
        common = float(np.asarray(scale))
    elif old.scale_per_taxel_per_n:
        # Taxels that do not answer have no scale.
        grown = [new / was for new, was in zip(each, old.scale_per_taxel_per_n, strict=True) if was > 0]
        common = old.scale_per_n * grown[0] if grown else common
    return ModelParameters(
        y_m=pose.y_m,
        alpha_deg=degrees(pose.alpha_rad),
        elasticity_pa_per_m=model.elasticity_pa_per_m,
        scale_per_n=common,
        beta_deg=None if old.beta_deg is None else degrees(pose.beta_rad),
        x_m=None if old.beta_deg is not None else pose.x_m,
        scale_per_taxel_per_n=each,
        rest_counts=old.rest_counts,
    )


def _moved(name: str, interval: Interval, before: float, after: float) -> Interval:
    low, high = interval
    if name in _LOGARITHMIC:
        return low * after / before, high * after / before
    return low + after - before, high + after - before


def _shifted(name: str, column: FloatArray, before: float, after: float) -> FloatArray:
    return column * (after / before) if name in _LOGARITHMIC else column + (after - before)


def _effects(
    found: Refit,
    coords: Sequence[Coordinate],
    held: Mapping[str, Parameters],
    mean_square: float,
    dataset: Dataset,
    poses: tuple[str, ...],
    had: Set[str],
) -> tuple[Effect, ...]:
    spread = np.sqrt(np.maximum(np.diag(found.covariance)[BASE_SIZE:], 0.0) * max(1.0, mean_square))
    best = parameters_at(coords, found.x, held)
    ends = [parameters_at(coords, found.x + side * _WIDTH * spread, held) for side in (-1.0, 1.0)]
    # One that was named as it was seen has nothing that was fitted.
    free = {c.effect for c in coords} | (best.keys() - had)
    taxels = dataset.layout().taxels
    made: list[Effect] = []
    for name in (n for n in EFFECTS if n in free):
        own = {
            key: (
                np.minimum(ends[0][name][key], ends[1][name][key]),
                np.maximum(ends[0][name][key], ends[1][name][key]),
            )
            for key in best[name]
            if any(c.effect == name and c.parameter.name == key for c in coords)
        }
        made.append(effect_from(name, best[name], own, taxels=taxels, poses=poses))
    return tuple(made)
