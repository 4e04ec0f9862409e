"""From a calibration to ranges: what is known goes in, the rest stays assumed, the cloud stays whole."""

from dataclasses import replace

import numpy as np
import pytest
from calibrations import INTERVALS, make_calibration, on_a_plane
from effects.effect_sessions import BASE

from skincal.calibration import Effect, ModelParameters, effect_from
from skincal.effects import EFFECTS
from skincal.errors import InputError
from skincal.ranges import Parameter, from_calibration, narrowing, preset, read_ranges, write_ranges

ALL = (-np.inf, np.inf)


def known(low, high):
    return Parameter.uniform(low, high, source="calibrated")


@pytest.mark.parametrize("name", ["iros24", "icra26"])
def test_the_calibrated_replaces_and_the_rest_is_the_preset(name):
    ranges = from_calibration(make_calibration(), name)
    calibrated = {f"skin.{k}": known(*v) for k, v in INTERVALS.items()}
    for path, parameter in calibrated.items():
        assert ranges[path] == parameter
    assert set(ranges.calibrated()) == set(calibrated)
    rest = {path: p for path, p in ranges.items() if path not in calibrated}
    offsets = {"skin.x_offset_m", "skin.y_offset_m"}
    assert rest == {path: p for path, p in preset(name).items() if path not in {*calibrated, *offsets}}
    assert ranges.warnings == ()
    assert ranges.provenance["preset"] == name
    assert ranges.provenance["dataset_sha256"] == "ab" * 32


def test_unidentified_parameters_keep_the_preset():
    calibration = make_calibration(intervals=INTERVALS | {"elasticity_pa_per_m": (1e8, np.inf), "y_m": ALL})
    ranges = from_calibration(calibration)
    published = preset("iros24")
    for path in ("skin.elasticity_pa_per_m", "skin.y_m"):
        assert ranges[path] == published[path]
    assert ranges["skin.scale_per_n"].source == "calibrated"
    assert [w.place for w in ranges.warnings] == [
        "calibration.toml, [intervals] y_m",
        "calibration.toml, [intervals] elasticity_pa_per_m",
    ]
    assert "got [1e+08, inf]" in str(ranges.warnings[1])
    assert "the preset's range is used instead, as assumed" in str(ranges.warnings[1])


def test_a_preset_that_the_mount_rules_out_is_not_used():
    mount = make_calibration().mount
    longer = replace(mount, y_m=0.05, y_range_m=(0.045, 0.055))
    ranges = from_calibration(make_calibration(mount=longer, intervals=INTERVALS | {"y_m": ALL}))
    assert ranges["skin.y_m"] == Parameter.uniform(0.045, 0.055)
    assert "the range of the mount, 0.045 to 0.055" in str(ranges.warnings[0])


def test_a_preset_offset_stays_about_the_nominal_place():
    calibration = make_calibration(intervals=INTERVALS | {"y_m": ALL})
    ranges = from_calibration(calibration, "icra26")
    assert ranges["skin.y_m"] == Parameter.constant(0.0235)
    assert ranges["skin.y_offset_m"] == Parameter.uniform(-0.00025, 0.00025)
    assert "skin.x_offset_m" not in ranges
    cloud = from_calibration(calibration, "icra26", joint=True)
    assert "skin.y_offset_m" not in cloud


def test_without_a_mount_the_best_value_is_left():
    intervals = on_a_plane().intervals | {"x_m": ALL}
    ranges = from_calibration(on_a_plane(mount=None, intervals=intervals))
    assert ranges["skin.x_m"] == Parameter.constant(0.0005)
    assert "the best value 0.0005" in str(ranges.warnings[0])


@pytest.mark.parametrize("name", ["iros24", "icra26"])
def test_on_a_plane_there_is_no_angle_round_the_finger(name):
    ranges = from_calibration(on_a_plane(), name)
    assert "skin.beta_deg" not in ranges
    assert "skin.x_offset_m" not in ranges
    assert ranges["skin.x_m"] == known(-0.001, 0.001)
    open_x = on_a_plane(intervals=on_a_plane().intervals | {"x_m": ALL})
    assert from_calibration(open_x)["skin.x_m"] == Parameter.uniform(-0.004, 0.004)


@pytest.mark.parametrize("name", ["iros24", "icra26"])
def test_scales_of_the_taxels_are_offsets_from_the_common_one(name):
    scales = tuple(68.0 + np.linspace(-8.0, 8.0, 16))
    model = ModelParameters(0.0235, -3.0, 5.1e8, 68.0, beta_deg=2.1, scale_per_taxel_per_n=scales)
    ranges = from_calibration(make_calibration(model=model), name)
    sample = ranges.sample(np.random.default_rng(0))["skin"]
    assert 61.0 <= sample["scale_per_n"] <= 76.0
    np.testing.assert_allclose(sample["scale_offset_per_n"], np.linspace(-8.0, 8.0, 16), atol=1e-12)
    assert ranges["skin.scale_offset_per_n"].source == "calibrated"


def test_a_dead_taxel_stays_dead_in_every_draw():
    scales = (0.0, *[68.0] * 15)
    model = ModelParameters(0.0235, -3.0, 5.1e8, 68.0, beta_deg=2.1, scale_per_taxel_per_n=scales)
    wide = replace(make_calibration(model=model), draws=None)
    wide = replace(wide, intervals={**wide.intervals, "scale_per_n": (40.0, 220.0)})
    ranges = from_calibration(wide)
    assert ranges["skin.scale_offset_per_n"].value[0] <= -220.0


def constant(value):
    return Parameter.constant(value, source="calibrated")


def test_effects_bring_their_parameters():
    gains = tuple(0.9 + 0.01 * j for j in range(16))
    low, high = (tuple(g + d for g in gains) for d in (-0.05, 0.05))
    effects = (
        Effect(
            "creep",
            {"time_constant_s": 2.0, "amplitude": 0.1, "breadth": 0.0},
            {"time_constant_s": (1.0, np.inf), "amplitude": (-9.0, 0.2)},
        ),
        Effect("taxel_gain", {"gain": gains}, {"gain": (low, high)}),
        Effect(
            "force_bias",
            {"pose_scale": (1.1, 0.9)},
            {"pose_scale": ((1.0, 0.8), (1.2, 1.0))},
            poses=("a", "b"),
        ),
    )
    ranges = from_calibration(make_calibration(effects=effects))
    log = Parameter.log_uniform
    assert ranges.table("skin.effects") == {
        "creep.time_constant_s": log(1.0, 200.0, source="calibrated"),
        "creep.amplitude": known(-0.6, 0.2),
        "creep.breadth": constant(0.0),
        "taxel_gain.gain": log(low, high, source="calibrated"),
        "force_bias.pose_scale": known((1.0, 0.8), (1.2, 1.0)),
    }
    assert ranges.provenance["poses_of_force_bias"] == "a, b"
    assert [w.place for w in ranges.warnings] == ["calibration.toml, [effects] force_bias"]


def test_parameters_without_interval_stay_at_the_estimate():
    ends = (-np.inf,) * 3 + (0.9,) * 13, (np.inf,) * 3 + (1.2,) * 13
    effects = (
        Effect("taxel_gain", {"gain": (1.0,) * 16}, {"gain": ends}),
        Effect("creep", {"amplitude": 0.2, "breadth": 1.0}, {"breadth": (-np.inf, np.inf)}),
    )
    ranges = from_calibration(make_calibration(effects=effects))
    assert ranges["skin.effects.taxel_gain.gain"].low == (1.0,) * 3 + (0.9,) * 13
    assert ranges["skin.effects.taxel_gain.gain"].high == (1.0,) * 3 + (1.2,) * 13
    assert ranges["skin.effects.creep.breadth"] == constant(1.0)
    assert [w.fix for w in ranges.warnings] == [
        "The data do not determine gain of 3 of 16; the fitted value stays.",
        "The data do not determine breadth; the fitted value stays.",
    ]


def test_per_taxel_values_replace_the_common_assumption():
    offsets = Effect("taxel_offset", {"offset_counts": tuple(np.linspace(-3, 3, 16))})
    gains = Effect("taxel_gain", {"gain": tuple(np.linspace(0.9, 1.1, 16))})
    ranges = from_calibration(make_calibration(effects=(offsets, gains)), "icra26")
    assert ranges["skin.taxel_offset_counts"] == constant(0.0)
    assert ranges["skin.scale_offset_per_n"] == constant(0.0)
    neutral = from_calibration(make_calibration(effects=(Effect("taxel_offset", {"offset_counts": 0.0}),)))
    assert neutral["skin.taxel_offset_counts"] == preset("iros24")["skin.taxel_offset_counts"]


def case_of(name: str, width: float) -> Effect:
    """A typical case with intervals that are some part of the bounds wide, and reach beyond them at times."""
    given = EFFECTS[name].at_strength(1.0, np.random.default_rng(4), make_calibration().layout())
    pairs = {
        key: (value - width * (p.high - p.low), value + width * (p.high - p.low))
        for key, value in given.items()
        for p in [EFFECTS[name].parameter(key)]
    }
    return effect_from(name, given, pairs, taxels=16, poses=("a", "b"))


@pytest.mark.parametrize("suffix", ["toml", "json", "yaml"])
@pytest.mark.parametrize("name", EFFECTS)
def test_draws_of_every_effect_go_into_a_skin(tmp_path, name, suffix):
    ranges = from_calibration(make_calibration(effects=(case_of(name, 0.3),)))
    write_ranges(ranges, tmp_path / f"r.{suffix}")
    back = read_ranges(tmp_path / f"r.{suffix}")
    assert back == ranges
    rng = np.random.default_rng(0)
    for _ in range(5):
        drawn = back.sample(rng)["skin"]["effects"]
        (applied,) = BASE.with_effects(drawn).effects
        assert applied.effect.name == name
        assert not applied.neutral


@pytest.mark.parametrize("name", EFFECTS)
def test_without_an_interval_the_estimate_is_drawn(name):
    found = case_of(name, 0.0)
    for effect in (found, Effect(name, found.parameters)):
        drawn = from_calibration(make_calibration(effects=(effect,))).sample(np.random.default_rng(1))
        for key, value in found.parameters.items():
            assert np.array_equal(drawn["skin"]["effects"][name][key], value)
    neutral = Effect(name, {p.name: p.neutral for p in EFFECTS[name].parameters})
    drawn = from_calibration(make_calibration(effects=(neutral,))).sample(np.random.default_rng(1))
    assert BASE.with_effects(drawn["skin"]["effects"]).effects[0].neutral


def test_the_cloud_may_hold_effects(tmp_path):
    calibration = make_calibration(effects=(Effect("creep", {"amplitude": 0.2}, {"amplitude": (0.1, 0.3)}),))
    draws = dict(calibration.draws) | {"effects.creep.amplitude": np.linspace(0.1, 0.3, 200)}
    ranges = from_calibration(replace(calibration, draws=draws), joint=True)
    write_ranges(ranges, tmp_path / "r.toml")
    drawn = read_ranges(tmp_path / "r.toml").sample(np.random.default_rng(1))["skin"]
    row = np.flatnonzero(draws["effects.creep.amplitude"] == drawn["effects"]["creep"]["amplitude"])
    assert draws["y_m"][row[0]] == drawn["y_m"]


def test_the_cloud_is_rows_of_the_valley(tmp_path):
    calibration = make_calibration(rows=900)
    ranges = from_calibration(calibration, joint=True, draws=300)
    assert ranges.joint is not None
    assert ranges.joint.columns == tuple(f"skin.{name}" for name in calibration.draws)
    rows = np.column_stack(list(calibration.draws.values()))
    assert len(ranges.joint) == 300
    assert set(map(tuple, ranges.joint.draws)) <= set(map(tuple, rows))
    np.testing.assert_allclose(ranges.joint.draws.mean(axis=0), rows.mean(axis=0), rtol=0.05)
    for suffix in ("toml", "json", "yaml"):
        write_ranges(ranges, tmp_path / f"r.{suffix}")
        assert read_ranges(tmp_path / f"r.{suffix}") == ranges
    rng = np.random.default_rng(0)
    skins = [read_ranges(tmp_path / "r.toml").sample(rng)["skin"] for _ in range(3)]
    for skin in skins:
        rise = (skin["elasticity_pa_per_m"] - 236e6) / 612e6
        assert rise == pytest.approx((skin["y_m"] - 0.02175) / 0.0035)


def test_fewer_draws_than_asked_for_are_all_kept():
    ranges = from_calibration(make_calibration(rows=3), joint=True)
    assert len(ranges.joint) == 3


def test_a_cloud_that_is_not_there_is_said():
    with pytest.raises(InputError, match="draws from the valley"):
        from_calibration(make_calibration(draws=None), joint=True)
    with pytest.raises(InputError, match="above 0"):
        from_calibration(make_calibration(), joint=True, draws=0)
    untold = dict.fromkeys(make_calibration().intervals, (-np.inf, np.inf))
    with pytest.raises(InputError, match="a parameter that the data determine; got none"):
        from_calibration(make_calibration(intervals=untold), joint=True, assumed_scale=(50.0, 80.0))
    with pytest.raises(InputError, match="iros24, icra26"):
        from_calibration(make_calibration(), "iros25")


def test_narrowing_compares_with_the_preset():
    rows = {row.path: row for row in narrowing(from_calibration(make_calibration()), preset("iros24"))}
    assert set(rows) == {f"skin.{name}" for name in INTERVALS}
    assert rows["skin.y_m"].ratio == pytest.approx(3.5 / 4)
    assert rows["skin.beta_deg"].ratio == pytest.approx(5.03 / 24)
    assert rows["skin.elasticity_pa_per_m"].ratio == pytest.approx(1.0)
    offsets = narrowing(from_calibration(make_calibration(), "icra26"), preset("icra26"))
    by_path = {row.path: row.ratio for row in offsets}
    assert by_path["skin.y_m"] == pytest.approx(3.5 / 0.5)
    assert np.isnan(by_path["skin.beta_deg"])


def test_a_scale_of_another_converter_is_not_compared():
    found = from_calibration(make_calibration())
    rows = {row.path: row for row in narrowing(found, preset("iros24"), same_converter=False)}
    assert rows["skin.scale_per_n"].published is None and np.isnan(rows["skin.scale_per_n"].ratio)
    assert rows["skin.elasticity_pa_per_m"].published is not None


def test_the_pose_of_a_flat_pad_is_not_compared_with_a_finger_s():
    flat = from_calibration(on_a_plane())
    rows = {row.path: row for row in narrowing(flat, preset("iros24"))}
    assert rows["skin.y_m"].published is None
    assert np.isnan(rows["skin.y_m"].ratio)
    assert rows["skin.elasticity_pa_per_m"].published is not None


def test_what_a_flat_pad_leaves_open_is_not_taken_from_a_finger():
    calibration = on_a_plane()
    found = from_calibration(replace(calibration, intervals=dict(calibration.intervals) | {"y_m": ALL}))
    assert found["skin.y_m"] != preset("iros24")["skin.y_m"]
    assert "preset's range" not in " ".join(problem.fix for problem in found.warnings)
