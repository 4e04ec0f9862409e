"""A calibration's effects fitted again, to another dataset of the same sensor."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from skincal.calibration import Calibration
from skincal.calibration.matching import check_same_sensor
from skincal.dataset import Dataset
from skincal.diagnose.fitted_presses import with_fitted_presses
from skincal.diagnose.newcal import new_calibration
from skincal.diagnose.options import DiagnoseOptions
from skincal.diagnose.prepare import Prepared, prepare
from skincal.effects import EFFECTS
from skincal.gap.candidates import Bench
from skincal.gap.free import Coordinate, coordinates, coordinates_at
from skincal.gap.hypothesis import Parameters
from skincal.gap.models import Material, finished, fitted
from skincal.gap.reading import Reading
from skincal.gap.robust import glitches, without_presses


def refitted_effects(
    dataset: Dataset, calibration: Calibration, known: Calibration, seed: int = 0
) -> Calibration:
    """A calibration of the base model, with the effects of another one fitted beside it.

    Sensor, places of presses and all numbers of the effects are found together, from those that ``known`` has. An
    effect that the dataset cannot speak of, for it lacks a covariate, stays as it was. Presses whose images are out of
    all proportion are left out, and presses are looked for again where others of their images' valleys fit better.

    Args:
        dataset: the session that ``calibration`` was fitted to.
        calibration: of the base model.
        known: has the effects.
        seed: of all chance.

    Raises:
        InputError: ``known`` is of another sensor.
        WorkError: too few presses.
    """
    check_same_sensor(known, dataset)
    both = replace(calibration, effects=known.effects)
    ready = prepare(dataset, both, DiagnoseOptions(), np.random.default_rng(seed))
    bench = Bench(ready.start, ready.session)
    coords, held = list[Coordinate](), dict[str, Parameters]()
    for name, parameters in ready.known_effects.items():
        own = coordinates(EFFECTS[name], bench.sizes, bench.lacking, _forms(name, parameters))
        coords += own
        free = {c.parameter.name for c in own}
        held[name] = {key: value for key, value in parameters.items() if not own or key not in free}
    x = coordinates_at(coords, ready.known_effects)
    fixed = {name: own for name, own in held.items() if own}
    whole = _of_all(ready, ready.reading)
    first = fitted(ready.start, tuple(coords), x, fixed, whole, ready.options.settle)
    wild = glitches(first.refit.slopes.residual, ready.reading.seen, ready.session.press)
    material = _of_all(ready, without_presses(ready.reading, ready.session.press, wild))
    if len(wild):
        # They have drawn sensor, places and effects after them: from the beginning, without them.
        first = fitted(ready.start, tuple(coords), x, fixed, material, ready.options.settle)
    found, reading = finished(first, material).refit, material.reading
    mean_square = float((found.slopes.residual[reading.seen] ** 2).mean())
    made = new_calibration(both, found, coords, fixed, mean_square, dataset, ready.poses)
    made = replace(made, provenance=calibration.provenance, grid=calibration.grid)
    return with_fitted_presses(made, found.hypothesis, ready.session, reading, dataset, wild)


def _of_all(ready: Prepared, reading: Reading) -> Material:
    """A session of which everything is fitted, and nothing kept to choose by."""
    every = np.ones(len(ready.session), dtype=np.bool_)
    return Material(ready.session, reading, every, ~every, ready.options)


def _forms(name: str, parameters: Parameters) -> Mapping[str, float]:
    """Where the forms of an effect start: at what they were."""
    scalar = [p for p in EFFECTS[name].parameters if p.role != "strength" and p.shape == "scalar"]
    return {p.name: float(parameters[p.name]) for p in scalar if p.name in parameters}
