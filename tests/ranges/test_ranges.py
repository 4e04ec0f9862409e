"""A set of parameters: immutable, checked as a whole; its draws, inside their ranges, and the rows of its cloud."""

from __future__ import annotations

import pickle
from functools import reduce
from operator import getitem
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

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


SEEDS = st.integers(0, 2**32 - 1)
FLOATS = st.floats(-1e9, 1e9, allow_nan=False)


def get(sample: Any, path: str) -> Any:
    return reduce(getitem, path.split("."), sample)


def leaves(sample, path=""):
    for key, value in sample.items():
        if isinstance(value, dict):
            yield from leaves(value, f"{path}{key}.")
        else:
            yield path + key, value


@given(seed=SEEDS, name=st.sampled_from(["iros24", "icra26"]), mode=st.sampled_from(["episode", "step"]))
def test_draws_stay_inside_and_are_all_there(seed, name, mode):
    ranges = preset(name)
    rng = np.random.default_rng(seed)
    sample = dict(leaves(ranges.sample(rng, mode, episode=ranges.sample(rng))))
    assert set(sample) == {path for path, parameter in ranges.items() if parameter.mode == mode}
    for path, value in sample.items():
        figures = ranges[path].figures()
        assert np.isfinite(value).all()
        if "low" in figures:
            assert np.all(value >= figures["low"])
            assert np.all(value <= figures["high"])
        if "value" in figures:
            assert value == figures["value"]


@given(bounds=st.tuples(FLOATS, FLOATS).map(sorted), seed=SEEDS)
def test_any_bounds_hold_even_equal_or_neighbouring_ones(bounds, seed):
    ranges = Ranges({"skin.scale_offset_per_n": Parameter.uniform(*bounds)})
    draws = get(ranges.sample(np.random.default_rng(seed), taxels=64), "skin.scale_offset_per_n")
    assert np.all((draws >= bounds[0]) & (draws <= bounds[1]))


@given(bounds=st.tuples(st.floats(1e-12, 1e12), st.floats(1e-12, 1e12)).map(sorted), seed=SEEDS)
def test_log_uniform_bounds_hold(bounds, seed):
    ranges = Ranges({"object.bolt.spinning_friction": Parameter.log_uniform(*bounds)})
    draw = get(ranges.sample(np.random.default_rng(seed)), "object.bolt.spinning_friction")
    assert bounds[0] <= draw <= bounds[1]


@given(seed=SEEDS)
def test_the_seed_decides_and_nothing_else(seed):
    ranges = preset("iros24")
    first, second = (dict(leaves(ranges.sample(np.random.default_rng(seed)))) for _ in range(2))
    for path, value in first.items():
        np.testing.assert_array_equal(value, second[path])


def test_the_order_of_the_parameters_does_not_matter():
    ranges = preset("iros24")
    turned = Ranges(dict(reversed(list(ranges.items()))))
    one, two = (dict(leaves(r.sample(np.random.default_rng(5)))) for r in (ranges, turned))
    assert list(one) == list(two)
    for path, value in one.items():
        np.testing.assert_array_equal(value, two[path])


def part(*paths):
    """Some parameters of a preset, which are drawn sooner than all."""
    return Ranges({path: preset("iros24")[path] for path in paths})


def many(ranges, path, count=4000):
    rng = np.random.default_rng(1)
    return np.array([get(ranges.sample(rng), path) for _ in range(count)])


def test_log_uniform_is_log_uniform():
    ranges = Ranges({"object.marble.spinning_friction": Parameter.log_uniform(2e-3, 2e-2)})
    logs = np.log(many(ranges, "object.marble.spinning_friction"))
    span = (np.log(2e-3), np.log(10))
    assert stats.kstest(logs, stats.uniform(*span).cdf).pvalue > 1e-3
    assert stats.kstest(np.exp(logs), stats.uniform(2e-3, 18e-3).cdf).pvalue < 1e-6


def test_uniform_is_uniform_and_normal_is_normal():
    ranges = Ranges(
        {
            "skin.alpha_deg": Parameter.uniform(-15.0, 15.0),
            "skin.beta_deg": Parameter.normal(2.0, 3.0, mode="episode"),
        }
    )
    assert stats.kstest(many(ranges, "skin.alpha_deg"), stats.uniform(-15, 30).cdf).pvalue > 1e-3
    assert stats.kstest(many(ranges, "skin.beta_deg"), stats.norm(2, 3).cdf).pvalue > 1e-3


def test_joint_offsets_are_independent():
    offsets = many(part("finger.joint_offset_rad"), "finger.joint_offset_rad")
    correlation = np.corrcoef(offsets.T) - np.eye(6)
    assert np.abs(correlation).max() < 0.06


def test_shapes_follow_joints_and_taxels():
    ranges = preset("icra26")
    sample = ranges.sample(np.random.default_rng(0), joints=9, taxels=25)
    assert sample["finger"]["joint_offset_rad"].shape == (9,)
    assert sample["finger"]["stick_friction_12_nm"].shape == (6,)
    assert sample["finger"]["stick_friction_3_nm"].shape == (3,)
    assert sample["skin"]["scale_offset_per_n"].shape == (25,)
    assert isinstance(sample["skin"]["scale_per_n"], float)
    assert preset("iros24").sample(np.random.default_rng(0))["object"]["marble"]["position_m"].shape == (3,)


def test_taxel_noise_has_the_level_of_the_episode():
    ranges = part("skin.taxel_noise_counts", "skin.noise_sigma_counts")
    rng = np.random.default_rng(3)
    episode = ranges.sample(rng)
    steps = [ranges.sample(rng, "step", episode=episode) for _ in range(4000)]
    noise = np.array([get(step, "skin.taxel_noise_counts") for step in steps])
    level = get(episode, "skin.noise_sigma_counts")
    np.testing.assert_allclose(noise.std(axis=0), level, rtol=0.06)
    assert np.abs(noise.mean(axis=0) / level).max() < 0.08


def test_what_a_draw_needs_and_does_not_get_is_said():
    ranges, rng = preset("iros24"), np.random.default_rng(0)
    with pytest.raises(ValueError, match="pass it"):
        ranges.sample(rng, "step")
    with pytest.raises(ValueError, match="episode, step"):
        ranges.sample(rng, "hour")
    with pytest.raises(ValueError, match="three joints per finger"):
        ranges.sample(rng, joints=7)
    gains = Ranges({"skin.scale_offset_per_n": Parameter.constant((1.0, 2.0, 3.0))})
    with pytest.raises(ValueError, match="3 numbers, but a draw has 16"):
        gains.sample(rng)
    np.testing.assert_array_equal(gains.sample(rng, taxels=3)["skin"]["scale_offset_per_n"], [1, 2, 3])


def cloud(rows=300):
    rng = np.random.default_rng(0)
    y = rng.uniform(0.02, 0.025, rows)
    return np.column_stack([y, 4e8 + (y - 0.0225) * 4e10, 60 + 1e3 * y])


@settings(max_examples=50)
@given(seed=SEEDS)
def test_joint_draws_are_rows_of_the_cloud(seed):
    rows = cloud()
    columns = ("skin.y_m", "skin.elasticity_pa_per_m", "skin.scale_per_n")
    ranges = Ranges(preset("iros24"), JointDraws(columns, rows))
    sample = ranges.sample(np.random.default_rng(seed))
    row = [get(sample, path) for path in columns]
    assert (rows == row).all(axis=1).any()
    assert isinstance(get(sample, "skin.alpha_deg"), float)


def test_joint_draws_keep_the_correlation_that_the_box_forgets():
    columns = ("skin.y_m", "skin.elasticity_pa_per_m", "skin.scale_per_n")
    box = {
        "skin.y_m": Parameter.uniform(0.02, 0.025),
        "skin.elasticity_pa_per_m": Parameter.uniform(3e8, 5e8),
        "skin.scale_per_n": Parameter.uniform(80.0, 85.0),
    }
    joint, boxed = Ranges(box, JointDraws(columns, cloud())), Ranges(box)
    for ranges, expected in ((joint, 1.0), (boxed, 0.0)):
        rng = np.random.default_rng(2)
        draws = [ranges.sample(rng)["skin"] for _ in range(1000)]
        pairs = np.array([[d["y_m"], d["elasticity_pa_per_m"]] for d in draws])
        assert np.corrcoef(pairs.T)[0, 1] == pytest.approx(expected, abs=0.1)


def test_joint_draws_are_even_over_the_rows():
    rows = np.arange(5.0)[:, None] * 1e-3
    ranges = Ranges({}, JointDraws(("skin.y_m",), rows))
    rng = np.random.default_rng(0)
    drawn = np.array([ranges.sample(rng)["skin"]["y_m"] for _ in range(5000)])
    counts = np.bincount(np.rint(drawn * 1e3).astype(int), minlength=5)
    assert stats.chisquare(counts).pvalue > 1e-3


def test_draws_by_full_name_are_those_of_the_tables() -> None:
    ranges = preset("iros24")
    one, other = np.random.default_rng(3), np.random.default_rng(3)
    tables, names = ranges.sample(one), ranges.draw(other)
    assert all(np.array_equal(get(tables, path), value) for path, value in names.items())
    step = ranges.sample(one, "step", episode=tables)
    for path, value in ranges.draw(other, "step", episode=names).items():
        assert np.array_equal(get(step, path), value)
