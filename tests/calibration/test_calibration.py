"""A calibration in memory: it is the skin that it describes."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from calibrations import make_calibration, on_a_plane
from published import FINGER, LAYOUT

from skincal.calibration import Calibration, Effect, Loss, ModelParameters, Provenance
from skincal.dataset import Dataset
from skincal.errors import WorkError
from skincal.model import Contacts, Patch, Plane, SensorPose, Skin, SkinParameters, Sphere


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
