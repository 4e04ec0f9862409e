"""Parameters of effects as a vector: there and back, within bounds, zero is neutral."""

from __future__ import annotations

import numpy as np
import pytest

from skincal.effects import EFFECTS
from skincal.gap.candidates import FORMS
from skincal.gap.free import clipped, coordinates, coordinates_at, names, parameters_at, priors, strengths

SIZES = {"scalar": 1, "per-taxel": 9, "per-pose": 2}
every_effect = pytest.mark.parametrize("name", EFFECTS)


@every_effect
def test_zero_is_neutral_and_what_is_given_as_form(name: str):
    for forms in FORMS.get(name, ({},)):
        coords = coordinates(EFFECTS[name], SIZES, forms=forms)
        found = parameters_at(coords, np.zeros(len(coords)))[name]
        checked = EFFECTS[name].checked(found, SIZES["per-taxel"])
        assert EFFECTS[name].is_neutral(checked)
        assert set(found) == {p.name for p in EFFECTS[name].parameters}
        assert all(found[key] == pytest.approx(value) for key, value in forms.items())


@every_effect
def test_coordinates_of_parameters_are_those_they_came_from(name: str):
    coords = coordinates(EFFECTS[name], SIZES)
    x = clipped(coords, 0.4 * np.random.default_rng(1).standard_normal(len(coords)))
    assert coordinates_at(coords, parameters_at(coords, x)) == pytest.approx(x, abs=1e-9)
    assert not coordinates_at(coords, {}).any()


@every_effect
def test_every_coordinate_within_its_bounds_is_a_parameter_that_the_effect_takes(name: str):
    coords = coordinates(EFFECTS[name], SIZES)
    rng = np.random.default_rng(0)
    for scale in (0.3, 3.0, 1e3):
        x = scale * rng.standard_normal(len(coords))
        inside = clipped(coords, x)
        one, other = (parameters_at(coords, at)[name] for at in (x, inside))
        EFFECTS[name].checked(one, SIZES["per-taxel"])
        assert all(np.allclose(one[key], other[key]) for key in one)
        assert (clipped(coords, inside) == inside).all()


@every_effect
def test_one_is_a_typical_strength(name: str):
    coords = coordinates(EFFECTS[name], SIZES)
    for c in coords:
        p = c.parameter
        if c.is_strength and p.typical:
            assert c.value(1.0) == pytest.approx(min(p.neutral + abs(p.typical), p.high))
            assert c.value(-1.0) == pytest.approx(max(p.neutral - abs(p.typical), p.low))
        low, high = c.bounds
        assert low <= 0 <= high
        assert c.value(low) == pytest.approx(p.low) and c.value(high) == pytest.approx(p.high)
        assert c.value(low / 2) < c.value(high / 2)
    assert (strengths(coords) == [c.parameter.role == "strength" for c in coords]).all()
    assert (priors(coords) > 0).all()


def test_a_coordinate_moves_its_own_number_only():
    coords = coordinates(EFFECTS["taxel_gain"], SIZES)
    assert names(coords)[4] == "gain[4]"
    x = np.zeros(9)
    x[4] = 0.5
    gain = parameters_at(coords, x)["taxel_gain"]["gain"]
    assert gain[4] == pytest.approx(1 + 0.5 * EFFECTS["taxel_gain"].parameter("gain").typical)
    assert (np.delete(gain, 4) == 1).all()


def test_what_is_held_stays_and_is_not_touched():
    held = {"dead_taxel": {"from_s": np.arange(9.0)}, "crosstalk": {"leak": np.asarray(0.1)}}
    coords = coordinates(EFFECTS["hysteresis"], SIZES)
    found = parameters_at(coords, np.ones(2), held)
    assert set(found) == {"dead_taxel", "crosstalk", "hysteresis"}
    assert (found["dead_taxel"]["from_s"] == np.arange(9.0)).all()
    found["dead_taxel"]["from_s"][0] = 7.0
    assert held["dead_taxel"]["from_s"][0] == 0.0


def test_data_without_a_covariate_cannot_speak_of_what_needs_it():
    assert coordinates(EFFECTS["creep"], SIZES, ["time"]) == ()
    assert coordinates(EFFECTS["shear"], SIZES, ["shear"]) == ()
    with_pose, without = (coordinates(EFFECTS["contact_offset"], SIZES, gone) for gone in ([], ["pose"]))
    assert len(with_pose) == 9 and len(without) == 5
    assert not any(c.parameter.shape == "per-pose" for c in without)
