"""From a calibration to ranges: what is known goes in, the rest stays assumed, the cloud stays whole."""

import numpy as np
import pytest
from calibrations import INTERVALS, make_calibration, on_a_plane

from skincal.calibration import Effect, ModelParameters
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


def test_what_the_data_leave_open_stays_the_presets_with_a_warning():
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
    assert "the preset's range takes its place, as assumed" in str(ranges.warnings[1])


def test_a_preset_that_the_mount_rules_out_is_not_used():
    from dataclasses import replace

    mount = make_calibration().mount
    longer = replace(mount, y_m=0.05, y_range_m=(0.045, 0.055))
    ranges = from_calibration(make_calibration(mount=longer, intervals=INTERVALS | {"y_m": ALL}))
    assert ranges["skin.y_m"] == Parameter.uniform(0.045, 0.055)
    assert "the range of the mount, 0.045 to 0.055" in str(ranges.warnings[0])


def test_a_preset_that_knows_an_offset_only_keeps_it_about_the_nominal_place():
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


def test_effects_bring_their_parameters():
    effects = (
        Effect("creep", {"tau_s": 2.0, "share": 0.1}, {"tau_s": (1.0, 4.0), "share": (0.0, np.inf)}),
        Effect("taxel_gain", {"gain": (1.0, 0.9)}, {"gain": ((0.9, 0.8), (1.1, 1.0))}),
    )
    ranges = from_calibration(make_calibration(effects=effects))
    assert ranges.table("skin.effects") == {
        "creep.tau_s": known(1.0, 4.0),
        "creep.share": Parameter.constant(0.1, source="calibrated"),
        "taxel_gain.gain": known((0.9, 0.8), (1.1, 1.0)),
    }


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
