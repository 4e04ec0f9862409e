"""A calibration loads into the simulator as it stands, effects included: a session at once, or sample by sample."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from calibrations import make_calibration
from effects.effect_sessions import SHORT
from published import LAYOUT

from skincal.calibration import (
    Effect,
    effect_from,
    effects_of,
    read_calibration,
    skin_of,
    stream_of,
    write_calibration,
)
from skincal.effects import EFFECTS, EffectSkin
from skincal.errors import InputError

COARSE_M = 1e-3


def case_of(name: str) -> Effect:
    """A typical case of an effect as a calibration has it."""
    given = EFFECTS[name].at_strength(1.0, np.random.default_rng(4), LAYOUT)
    return effect_from(name, given, taxels=16)


def with_effects(*effects: Effect):
    return make_calibration(effects=effects, draws=None, grid=None, slack=None)


@pytest.mark.parametrize("name", EFFECTS)
def test_every_effect_goes_through_a_file_into_the_simulator(tmp_path, name: str):
    calibration = with_effects(case_of(name))
    write_calibration(calibration, tmp_path / "cal")
    back = read_calibration(tmp_path / "cal")
    assert back.effects == calibration.effects
    skin = skin_of(back, COARSE_M)
    values = skin.values(SHORT)
    base = EffectSkin(back.base_skin(COARSE_M), back.surface_model())
    given = EFFECTS[name].at_strength(1.0, np.random.default_rng(4), LAYOUT)
    assert np.array_equal(values, base.with_effects({name: given}).values(SHORT))
    assert not np.array_equal(values, base.values(SHORT))
    stream = stream_of(back, COARSE_M)
    steps = np.vstack([stream.step(SHORT[k : k + 1]) for k in range(len(SHORT))])
    np.testing.assert_allclose(steps, values, rtol=0, atol=1e-9)


def test_no_or_neutral_effects_give_the_base_model():
    base = make_calibration()
    neutral = with_effects(*(Effect(name) for name in EFFECTS))
    one, other = (skin_of(c, COARSE_M).values(SHORT) for c in (base, neutral))
    assert np.array_equal(one, other)


def test_poses_go_by_their_names():
    calibration = with_effects(Effect("force_bias", {"pose_scale": (1.2, 0.8)}, poses=("bent", "flat")))
    own = effects_of(calibration)
    assert own["force_bias"]["pose_scale"].tolist() == [1.2, 0.8]
    turned = effects_of(calibration, ("flat", "new", "bent"))
    assert turned["force_bias"]["pose_scale"].tolist() == [0.8, 1.0, 1.2]
    # A dataset that says nothing of poses: the numbers stay, and the effect abstains.
    assert effects_of(calibration, ())["force_bias"]["pose_scale"].tolist() == [1.2, 0.8]
    skin = skin_of(calibration, COARSE_M, poses=("flat", "bent"))
    plain = skin_of(calibration, COARSE_M)
    swapped = replace(SHORT, pose=1 - SHORT.pose)
    assert np.array_equal(skin.values(SHORT), plain.values(swapped))


def test_one_number_stands_for_all_poses_whatever_their_names():
    calibration = with_effects(Effect("force_bias", {"pose_scale": 1.2}, poses=("bent", "flat")))
    assert effects_of(calibration, ("x",))["force_bias"]["pose_scale"] == 1.2


def test_an_effect_from_arrays_is_checked():
    gains, width = np.full(16, 1.1), (np.full(16, 1.0), np.full(16, 1.2))
    one = effect_from("taxel_gain", {"gain": gains}, {"gain": width}, taxels=16, poses=("a",))
    assert one == Effect("taxel_gain", {"gain": (1.1,) * 16}, {"gain": ((1.0,) * 16, (1.2,) * 16)})
    assert effect_from("creep", {"amplitude": np.float64(0.1)}, taxels=16).parameters == {"amplitude": 0.1}
    biased = effect_from("force_bias", {"pose_scale": [1.0, 1.1]}, taxels=16, poses=("a", "b"))
    assert biased.poses == ("a", "b")
    for name, given in (("crep", {}), ("creep", {"tau": 1.0}), ("creep", {"amplitude": 99.0})):
        with pytest.raises(InputError):
            effect_from(name, given, taxels=16)


def test_what_lacks_a_covariate_is_an_error_or_abstains():
    calibration = with_effects(Effect("rate", {"exponent": 0.1}))
    lacking = replace(SHORT, speed_m_per_s=None)
    with pytest.raises(InputError, match="speed_m_per_s"):
        skin_of(calibration, COARSE_M).values(lacking)
    abstaining = skin_of(calibration, COARSE_M, missing="abstain").values(lacking)
    assert np.array_equal(abstaining, skin_of(make_calibration(), COARSE_M).values(lacking))
