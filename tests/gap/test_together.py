"""Slopes by the numbers of all taxels at once are those by one after the other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gap.made_sessions import LAYOUT, MODEL, OPTIONS, arrays, case, made, pressed

from skincal.effects import EFFECTS, Stage
from skincal.effects.base import SignalEffect
from skincal.gap.candidates import Bench, secants
from skincal.gap.free import coordinates, parameters_at
from skincal.gap.hypothesis import Hypothesis
from skincal.gap.refit import refit
from skincal.gap.together import apart, together

SIZES = {"scalar": 1, "per-taxel": LAYOUT.taxels, "per-pose": 2}
OF_TAXELS = ("taxel_gain", "taxel_offset", "baseline_drift")
CROSSTALK = arrays({"crosstalk": {"leak": 0.2}})


@pytest.mark.parametrize("beside", [{}, CROSSTALK], ids=["alone", "crosstalk"])
@pytest.mark.parametrize("name", OF_TAXELS)
def test_slopes_at_once_are_slopes_one_by_one(name: str, beside: dict[str, dict[str, np.ndarray]]):
    session = pressed()
    bench = Bench(Hypothesis(MODEL, np.zeros((session.presses, 3)), beside), session)
    coords = coordinates(EFFECTS[name], SIZES)
    steps = np.where(np.array([c.bounds[1] for c in coords]) >= 0.05, 0.05, -0.05)
    zero = bench.values({})
    # From a point at which all numbers matter.
    start = 4 * steps
    here = bench.values(parameters_at(coords, start))
    alone = np.stack(
        [
            (bench.values(parameters_at(coords, start + steps * (np.arange(len(coords)) == k))) - here)
            / steps[k]
            for k in range(len(coords))
        ],
        axis=-1,
    )
    groups = together(coords, beside)
    mixed = name == "taxel_gain" and bool(beside)
    assert sorted(k for group in groups for k in group) == list(range(len(coords)))
    assert (len(groups) == len(coords)) == mixed
    for group in groups:
        at = start.copy()
        at[group] += steps[group]
        change = bench.values(parameters_at(coords, at)) - here
        found = apart(change, [coords[k] for k in group], steps[group], None)
        assert found == pytest.approx(alone[..., group], rel=1e-9, abs=1e-9)
    assert np.abs(here - zero).max() > 0.01 and np.abs(alone).max() > 0.01


@pytest.mark.parametrize(
    "name", [n for n, e in EFFECTS.items() if e.stage in (Stage.TRANSFER, Stage.CONVERTER)]
)
def test_stages_of_taxels_leave_the_others_alone(name: str):
    effect, session = EFFECTS[name], pressed()
    assert isinstance(effect, SignalEffect)
    samples, setting = session.samples, Hypothesis(MODEL, np.zeros((session.presses, 3))).skin.setting
    values = effect.checked(effect.at_strength(0.5, np.random.default_rng(0), LAYOUT), LAYOUT.taxels)
    signal = np.random.default_rng(1).uniform(0.5, 40.0, (len(samples), LAYOUT.taxels))
    other = signal.copy()
    other[:, 4] *= 1.5
    change = effect.apply(other, samples, values, setting) - effect.apply(signal, samples, values, setting)
    assert (np.delete(change, 4, axis=1) == 0).all() and np.abs(change[:, 4]).max() > 0


@pytest.mark.parametrize("beside", [{}, CROSSTALK], ids=["alone", "crosstalk"])
def test_slopes_of_a_fit_are_differences_of_its_values(beside: dict[str, dict[str, np.ndarray]]):
    one = made({}, pressed())
    coords = tuple(
        c
        for name in ("stiffening", "creep", "taxel_gain", "taxel_offset")
        for c in coordinates(EFFECTS[name], SIZES)
    )
    x = np.linspace(0.1, 0.4, len(coords))
    still = replace(OPTIONS, steps=0)
    found = refit(one.start, one.session, one.reading, still, coords, x, fixed=beside).slopes
    here = one.start.with_effects(parameters_at(coords, x, beside)).values(one.session)
    weight = one.reading.weight(here)
    for k in range(len(coords)):
        y = x.copy()
        y[k] += 0.03
        there = one.start.with_effects(parameters_at(coords, y, beside)).values(one.session)
        expected = (there - here) / 0.03 * weight
        assert found.effect[..., k] == pytest.approx(expected, rel=1e-6, abs=1e-6 * np.abs(expected).max())


def test_taxels_that_are_not_looked_at_have_no_slope():
    looked = np.array([1, 4, 8])
    coords = coordinates(EFFECTS["taxel_offset"], SIZES)
    steps = np.full(len(coords), 0.5)
    change = np.tile([1.0, 2.0, 3.0], (5, 1))
    found = apart(change, coords, steps, looked)
    assert found.shape == (5, 3, 9)
    expected = np.zeros((3, 9))
    expected[[0, 1, 2], looked] = [2.0, 4.0, 6.0]
    assert (found == expected).all()


def test_first_columns_are_those_of_each_number():
    of = case("taxel_gain").scene
    (start,) = of.bench.starts("taxel_offset")
    found = secants(of, start, np.arange(len(start.coords)))
    x = np.zeros(len(start.coords))
    x[3] = 0.25
    alone = (of.bench.values(parameters_at(start.coords, x)) - of.zero) / 0.25
    assert found[..., 3] == pytest.approx(alone, abs=1e-9)
    some = replace(start, coords=start.coords[3:4])
    assert secants(of, some, np.arange(1))[..., 0] == pytest.approx(alone, abs=1e-9)
