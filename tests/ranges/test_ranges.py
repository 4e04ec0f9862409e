"""A set of parameters: immutable, checked as a whole, and one value."""

import pickle

import numpy as np
import pytest

from skincal.errors import InputError
from skincal.ranges import PRESETS, JointDraws, Parameter, Ranges, preset

U = Parameter.uniform


def test_everything_wrong_in_a_set_is_said_at_once():
    with pytest.raises(InputError) as caught:
        Ranges(
            {
                "skin.y_mm": U(21.5, 25.5),
                "skin.y_m": U(21.5, 25.5),
                "skin.beta_deg": U((0.0, 1.0), (1.0, 2.0)),
                "skin.taxel_noise_counts": Parameter.normal(0.0, "skin.sigma"),
                "object.cube.mass_kg": U(0.0, 1.0),
                "skin.effects.slowness.tau_s": U(0.0, 1.0),
                "object.marble.position_m": U((0.0, 0.0), (1e-3, 1e-3)),
            }
        )
    text = str(caught.value)
    assert len(caught.value.problems) == 8
    assert "[skin.y_mm]: expected one of skin.x_m, skin.y_m" in text
    assert "Did you mean skin.y_m?" in text
    assert "[skin.y_m] low: expected -1 to 1 m; got 21.5. Is the unit m?" in text
    assert "[skin.beta_deg]: expected one number; got a list of 2" in text
    assert "[skin.taxel_noise_counts] sigma_from" in text
    assert "finger, object.marble, object.bolt, skin" in text
    assert "NAME one of force_bias, contact_offset" in text
    assert "[object.marble.position_m]: expected one number, or three" in text


@pytest.mark.parametrize("level", [U(0.0, 5.0, mode="step"), Parameter.normal(1.0, 1.0, mode="episode")])
def test_noise_needs_a_level_drawn_per_episode(level):
    noise = Parameter.normal(0.0, "skin.noise_sigma_counts")
    with pytest.raises(InputError, match="sigma_from"):
        Ranges({"skin.noise_sigma_counts": level, "skin.taxel_noise_counts": noise})


def test_the_parameters_of_an_effect_are_those_of_the_registry():
    gains = U((0.9,) * 16, (1.1,) * 16)
    ranges = Ranges(
        {
            "skin.effects.hysteresis.height": U(0.0, 0.2),
            "skin.effects.taxel_gain.gain": gains,
            "skin.effects.taxel_offset.offset_counts": U(-1.0, 1.0),
            "skin.effects.force_bias.pose_scale": U((0.9, 1.0), (1.1, 1.2)),
            "skin.effects.contact_offset.pose_along_m": U(0.0, 1e-3),
            "skin.effects.creep.amplitude": Parameter.normal(0.0, 9.0, mode="episode"),
        }
    )
    effects = ranges.sample(np.random.default_rng(0))["skin"]["effects"]
    assert isinstance(effects["hysteresis"]["height"], float)
    assert effects["taxel_gain"]["gain"].shape == effects["taxel_offset"]["offset_counts"].shape == (16,)
    assert len(set(effects["taxel_offset"]["offset_counts"])) == 16
    assert effects["force_bias"]["pose_scale"].shape == (2,)
    assert isinstance(effects["contact_offset"]["pose_along_m"], float)
    drawn = [
        ranges.sample(np.random.default_rng(s))["skin"]["effects"]["creep"]["amplitude"] for s in range(9)
    ]
    assert min(drawn) == -0.6
    assert max(drawn) == 1.5
    with pytest.raises(ValueError, match="16 numbers, but a draw has 25"):
        ranges.sample(np.random.default_rng(0), taxels=25)


@pytest.mark.parametrize(
    ("path", "parameter", "words"),
    [
        (
            "hysteresis.hight",
            U(0.0, 0.2),
            "expected one of skin.effects.hysteresis.height, skin.effects.hysteresis",
        ),
        ("hysteresis.hight", U(0.0, 0.2), "Did you mean skin.effects.hysteresis.height?"),
        ("hysteresys.height", U(0.0, 0.2), "Did you mean skin.effects.hysteresis.height?"),
        ("hysteresis.height", U(0.0, 2.0), "high: expected -0.8 to 1.5; got 2"),
        ("latency.delay_s", U(0.0, 20.0), "expected 0 to 1 s; got 20. Is the unit s?"),
        ("hysteresis.height", U((0.0, 0.1), (0.2, 0.2)), "expected one number; got a list of 2"),
    ],
)
def test_what_is_wrong_with_an_effect_is_said(path, parameter, words):
    with pytest.raises(InputError) as caught:
        Ranges({f"skin.effects.{path}": parameter})
    assert words in str(caught.value)


def test_it_is_a_mapping_that_cannot_be_changed():
    ranges = preset("iros24")
    assert ranges["skin.scale_per_n"] == U(61.0, 76.0)
    assert len(ranges) == len(list(ranges)) == len(PRESETS["iros24"])
    assert ranges.table("object.bolt")["radius_m"].value == 0.006
    with pytest.raises(AttributeError):
        ranges.joint = None
    with pytest.raises(TypeError):
        ranges["skin.y_m"] = U(0.0, 1.0)  # type: ignore[index]
    with pytest.raises(TypeError):
        hash(ranges)


def test_replace_leaves_the_original():
    ranges = preset("iros24")
    wider = ranges.replace({"skin.scale_per_n": U(50.0, 80.0)})
    assert wider["skin.scale_per_n"].low == 50.0
    assert ranges["skin.scale_per_n"].low == 61.0
    assert wider != ranges
    assert wider.provenance == ranges.provenance


def test_it_survives_pickling():
    ranges = Ranges(preset("icra26"), JointDraws(("skin.scale_per_n",), [[70.0], [71.0]]))
    assert pickle.loads(pickle.dumps(ranges)) == ranges


def test_what_a_task_needs_and_does_not_find_is_said_at_once():
    preset("iros24").require(["skin.y_m", "object.marble.mass_kg"])
    with pytest.raises(InputError) as caught:
        preset("icra26").require(["skin.y_m", "object.marble.mass_kg", "skin.scale_per_n"])
    assert [p.place for p in caught.value.problems] == [
        "ranges, [skin.y_m]",
        "ranges, [object.marble.mass_kg]",
    ]


@pytest.mark.parametrize(
    ("columns", "draws", "words"),
    [
        (("skin.y_m",), [[np.nan]], "finite numbers"),
        (("skin.y_m",), [[0.1, 0.2]], "rows of 1 numbers"),
        (("skin.y_m",), np.zeros((0, 1)), "one or more rows"),
        (("skin.y_m", "skin.y_m"), [[0.1, 0.1]], "each once"),
        (("finger.joint_offset_rad",), [[0.1]], "single figures of the skin"),
        (("skin.taxel_offset_counts",), [[0.1]], "single figures of the skin"),
    ],
)
def test_a_cloud_that_cannot_be_is_refused(columns, draws, words):
    with pytest.raises(InputError, match=words):
        JointDraws(columns, draws)


def test_a_cloud_is_read_only_and_a_copy():
    rows = np.array([[0.02], [0.03]])
    joint = JointDraws(("skin.y_m",), rows)
    rows[0, 0] = 1.0
    assert joint.draws[0, 0] == 0.02
    with pytest.raises(ValueError, match="read-only"):
        joint.draws[0, 0] = 1.0
