"""A calibration in memory: the skin that it describes, effects included: a session at once, or sample by sample."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest
from calibrations import make_calibration, on_a_plane
from effects.effect_sessions import SHORT
from published import FINGER, LAYOUT

from skincal.calibration import (
    Calibration,
    Effect,
    Loss,
    ModelParameters,
    Provenance,
    effect_from,
    effects_of,
    read_calibration,
    skin_of,
    stream_of,
    write_calibration,
)
from skincal.dataset import Dataset
from skincal.effects import EFFECTS, EffectSkin
from skincal.errors import InputError, WorkError
from skincal.model import Contacts, Patch, Plane, SensorPose, Skin, SkinParameters, Sphere

COARSE_M = 1e-3


def press(skin, radius_m=0.0115):
    """The image of a press of 3 N a little off the centre of the nominal patch."""
    beta = 0.05
    point = np.array([[radius_m * np.sin(beta), 0.0242, radius_m * np.cos(beta)]])
    return skin.image(Sphere(0.006), Contacts(point, point * [[1, 0, 1]] / radius_m, [3.0]))


def test_the_skin_is_the_one_built_by_hand():
    pose = SensorPose(0.0235, np.radians(-3.0), beta_rad=np.radians(2.1))
    by_hand = Skin(Patch.build(FINGER, LAYOUT, pose), SkinParameters(5.1e8, 68.0))
    skin = make_calibration().skin()
    image = press(skin)
    np.testing.assert_array_equal(image, press(by_hand))
    assert image.sum() > 40
    assert len(skin.patch.points_m) == 122 * 122


def test_the_scale_of_each_taxel_goes_before_the_common_one():
    scales = tuple(np.linspace(0.0, 136.0, 16))
    model = ModelParameters(0.0235, -3.0, 5.1e8, 68.0, beta_deg=2.1, scale_per_taxel_per_n=scales)
    loose = {"value_max": None, "value_min": None, "integer": False}
    base = make_calibration()
    sensor = replace(base.sensor, **loose)
    one = press(make_calibration(sensor=sensor).skin(resolution_m=0.5e-3))
    each = press(make_calibration(sensor=sensor, model=model).skin(resolution_m=0.5e-3))
    np.testing.assert_allclose(each, one * np.array(scales) / 68.0, rtol=1e-12)


def test_on_a_plane():
    calibration = on_a_plane()
    assert calibration.pose() == SensorPose(0.0235, np.radians(-3.0), x_m=0.0005)
    assert isinstance(calibration.surface_model(), Plane)
    patch = calibration.skin(resolution_m=1e-3).patch
    np.testing.assert_allclose(patch.points_m.mean(axis=0), [0.0005, 0.0235, 0.0], atol=1e-9)


def test_a_skin_without_effects_is_refused_where_there_are_some():
    calibration = make_calibration(effects=(Effect("creep", {"amplitude": 0.2}), Effect("spread")))
    with pytest.raises(WorkError, match=r"creep, spread.*skin_of"):
        calibration.skin()
    assert calibration.base_skin(resolution_m=1e-3).parameters.scale_per_n == 68.0
    assert calibration.pose() == make_calibration().pose()


def test_best_names_the_figures_of_the_contract():
    cylinder = ["y_m", "beta_deg", "alpha_deg", "elasticity_pa_per_m", "scale_per_n"]
    assert list(make_calibration().model.best()) == cylinder
    assert list(on_a_plane().model.best()) == ["y_m", "x_m", *cylinder[2:]]


def test_identified_is_bounded_on_both_sides():
    intervals = {"y_m": (0.0, 1.0), "beta_deg": (-np.inf, 3.0), "alpha_deg": (-np.inf, np.inf)}
    calibration = make_calibration(intervals=intervals)
    assert [calibration.identified(name) for name in (*intervals, "scale_per_n")] == [
        True,
        False,
        False,
        False,
    ]


def test_of_dataset_takes_what_the_dataset_says(session):
    dataset: Dataset = session()
    model = ModelParameters(0.0235, 0.0, 4e8, 70.0, beta_deg=0.0)
    calibration = Calibration.of_dataset(
        dataset, model=model, intervals={}, loss=Loss(1.0, 2.0, 3), provenance=Provenance("x"), grid=None
    )
    assert calibration.sensor == dataset.meta.sensor
    assert calibration.mount == dataset.meta.mount
    assert calibration.pose() == dataset.nominal_pose()
    assert calibration.converter() == dataset.converter()
    assert calibration.indenter_model(0.004) == dataset.indenter(0.004) == Sphere(0.004)


def test_it_goes_to_another_process_and_is_read_only():
    calibration = pickle.loads(pickle.dumps(make_calibration()))
    assert calibration.model == make_calibration().model
    own = np.array([1.0])
    made = make_calibration(grid={"y_m": own})
    with pytest.raises(ValueError, match="read-only"):
        made.grid["y_m"][0] = 2.0
    own[0] = 3.0


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
