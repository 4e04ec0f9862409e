"""The folder of a calibration: exact, whole or not at all, every fault with its file and key."""

import shutil
import tomllib
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from calibrations import make_calibration, make_slack, on_a_plane
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from skincal.calibration import (
    EFFECT_NAMES,
    Effect,
    Loss,
    ModelParameters,
    Provenance,
    read_calibration,
    write_calibration,
)
from skincal.calibration.parts import ELASTICITY_PA_PER_M
from skincal.dataset import IndenterSpec, SurfaceSpec, TaxelPositions
from skincal.effects import EFFECTS
from skincal.errors import InputError

PARTS = ("sensor", "surface", "indenter", "mount", "position", "model", "intervals", "loss", "effects",
         "findings", "provenance", "extra")  # fmt: skip


GAINS = tuple(0.9 + 0.02 * j for j in range(16))


def assert_same(one, two):
    for name in PARTS:
        assert getattr(one, name) == getattr(two, name), name
    for name in ("grid", "slack", "draws"):
        left, right = getattr(one, name), getattr(two, name)
        assert (left is None) == (right is None), name
        if left is not None:
            assert list(left) == list(right)
            for key, column in left.items():
                np.testing.assert_array_equal(column, right[key], err_msg=f"{name} {key}")


def problems(path):
    with pytest.raises(InputError) as caught:
        read_calibration(path)
    return caught.value.problems


def test_a_value_far_outside_its_interval_is_reported(tmp_path):
    calibration = make_calibration()
    low, high = calibration.intervals["scale_per_n"]
    for n, (value, told) in enumerate([(high + 0.5 * (high - low), 0), (3 * high, 1), (low / 3, 1)]):
        changed = replace(calibration, model=replace(calibration.model, scale_per_n=value))
        write_calibration(changed, tmp_path / f"cal{n}")
        warnings = read_calibration(tmp_path / f"cal{n}").warnings
        assert [w.place.endswith("calibration.toml, [model] scale_per_n") for w in warnings] == [True] * told
        assert all("fit the session again" in str(w) for w in warnings)


@pytest.mark.parametrize("make", [make_calibration, on_a_plane])
def test_what_is_written_is_read_exactly(tmp_path, make):
    calibration = make(
        effects=(
            Effect("hysteresis", {"width": 0.1}, {"width": (0.05, 0.2)}, {"p_value": 0.002}),
            Effect("taxel_gain", {"gain": GAINS}, {"gain": ((0.8,) * 16, (1.4,) * 15 + (np.inf,))}),
            Effect("force_bias", {"offset_n": 0.2, "pose_scale": (1.1, 0.9)}, poses=("bent", "straight")),
        ),
        extra={"note": "made by hand"},
    )
    write_calibration(calibration, tmp_path / "cal")
    back = read_calibration(tmp_path / "cal")
    assert_same(back, calibration)
    assert [problem.place for problem in back.warnings] == [f"{tmp_path}/cal/calibration.toml, note"]
    assert read_calibration(tmp_path / "cal" / "calibration.toml").model == calibration.model
    assert sorted(p.name for p in tmp_path.iterdir()) == ["cal"]


NUMBERS = st.floats(-1e100, 1e100)
BOUNDS = st.tuples(st.floats(allow_nan=False), st.floats(allow_nan=False)).map(sorted).map(tuple)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=40)
@given(
    y_m=st.floats(-1, 1),
    alpha_deg=NUMBERS,
    elasticity=st.floats(*ELASTICITY_PA_PER_M),
    bounds=BOUNDS,
    text=st.text(st.characters(codec="utf-8")),
    name=st.sampled_from(sorted(EFFECT_NAMES)),
    draws=st.lists(st.floats(-1e12, 1e12), min_size=1, max_size=4),
)
def test_any_figures_come_back(tmp_path, y_m, alpha_deg, elasticity, bounds, text, name, draws):
    calibration = make_calibration(
        model=ModelParameters(y_m, alpha_deg, elasticity, 68.0, beta_deg=1.0),
        intervals=make_calibration().intervals | {"alpha_deg": bounds},
        provenance=Provenance(text, dataset=text, options={"a": {"b": [1, 2]}}),
        effects=(Effect(name, {p.name: p.neutral for p in EFFECTS[name].parameters}, extra={"e": draws}),),
        draws={"y_m": np.array(draws)},
    )
    write_calibration(calibration, tmp_path / "cal", force=True)
    assert_same(read_calibration(tmp_path / "cal"), calibration)


def test_the_file_is_the_contracts(tmp_path):
    calibration = make_calibration(
        intervals=make_calibration().intervals | {"scale_per_n": (-np.inf, np.inf)},
        effects=(Effect("creep", {"time_constant_s": 2.0}),),
    )
    write_calibration(calibration, tmp_path / "cal")
    values = tomllib.loads((tmp_path / "cal" / "calibration.toml").read_text())
    assert values["format"] == "skincal-calibration/1"
    assert values["model"] == {
        "y_m": 0.0235,
        "beta_deg": 2.1,
        "alpha_deg": -3.0,
        "elasticity_pa_per_m": 5.1e8,
        "scale_per_n": 68.0,
    }
    assert values["intervals"]["y_m"] == [0.02175, 0.02525]
    assert values["intervals"]["scale_per_n"] == [-np.inf, np.inf]
    assert values["loss"] == {
        "mse_counts2": 9.1, "valley_mse_counts2": 25.0, "presses_used": 24, "noise_counts": 1.1,
    }  # fmt: skip
    assert values["effects"] == [{"name": "creep", "parameters": {"time_constant_s": 2.0}}]
    assert values["provenance"]["dataset_sha256"] == "ab" * 32
    assert values["sensor"]["taxel_size_m"] == 0.0025
    header = (tmp_path / "cal" / "slack.csv").read_text().splitlines()[0]
    assert header.startswith("press,used,reason,x_m")


def test_numpy_values_and_what_is_none_are_written_too(tmp_path):
    calibration = make_calibration(
        model=ModelParameters(np.float64(0.0235), np.float32(-3.0), 5.1e8, np.int64(68), beta_deg=0),
        intervals={k: np.array(v) for k, v in make_calibration().intervals.items()},
        loss=Loss(np.float64(9.1), 25, np.int64(24), {"by_taxel": np.arange(3.0), "none": None}),
        provenance=Provenance("x", seed=np.int64(3), options={"path": tmp_path, "steps": (np.float64(1), 2)}),
    )
    write_calibration(calibration, tmp_path / "cal")
    back = read_calibration(tmp_path / "cal")
    assert back.loss == Loss(9.1, 25, 24, {"by_taxel": [0.0, 1.0, 2.0]})
    assert back.provenance.options == {"path": str(tmp_path), "steps": [1.0, 2]}
    assert back.provenance.seed == 3
    assert back.intervals["y_m"] == (0.02175, 0.02525)


def test_a_plain_toml_is_enough(tmp_path):
    """A calibration that somebody else wrote by the contract: no tables, findings, mount or position."""
    write_calibration(make_calibration(), tmp_path / "cal")
    for name in ("grid.parquet", "slack.csv", "draws.parquet"):
        (tmp_path / "cal" / name).unlink()
    path = tmp_path / "cal" / "calibration.toml"
    values = tomllib.loads(path.read_text())
    for name in ("mount", "position", "findings", "effects"):
        del values[name]
    import tomli_w

    path.write_text(tomli_w.dumps(values))
    back = read_calibration(tmp_path / "cal")
    assert (back.mount, back.findings, back.effects, back.draws) == (None, (), (), None)
    assert back.skin(resolution_m=1e-3).parameters.scale_per_n == 68.0


def test_a_mesh_and_taxel_positions_come_along(tmp_path):
    tip = trimesh.creation.cylinder(0.0115, 0.06, sections=64).apply_transform(
        trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0])
    )
    mesh = tip.subdivide().apply_translation([0, 0.0235, 0]).export(file_type="stl")
    punch = trimesh.creation.icosphere(2, 0.006).apply_translation([0, 0, 0.006]).export(file_type="stl")
    base = make_calibration()
    grid = base.layout()
    calibration = make_calibration(
        sensor=replace(base.sensor, positions="taxels.csv"),
        surface=SurfaceSpec("mesh", file="tip.stl"),
        indenter=IndenterSpec("mesh", file="punch.stl"),
        meshes={"tip.stl": mesh, "punch.stl": punch},
        positions=TaxelPositions(grid.centres_m * 1.01, grid.sizes_m),
    )
    write_calibration(calibration, tmp_path / "cal")
    shutil.move(tmp_path / "cal", tmp_path / "moved")
    back = read_calibration(tmp_path / "moved")
    assert back.meshes == calibration.meshes
    np.testing.assert_array_equal(back.layout().centres_m, grid.centres_m * 1.01)
    points = back.skin(resolution_m=1e-3).patch.points_m
    assert np.hypot(points[:, 0], points[:, 2]) == pytest.approx(0.0115, abs=2e-5)
    assert back.indenter_model() is not None


def edited(tmp_path, *changes):
    """A calibration on disk with some text of its TOML replaced."""
    write_calibration(
        make_calibration(effects=(Effect("creep", {"time_constant_s": 2.0}),)), tmp_path / "cal"
    )
    path = tmp_path / "cal" / "calibration.toml"
    text = path.read_text()
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new, 1)
    path.write_text(text)
    return tmp_path / "cal"


@pytest.mark.parametrize(
    ("figure", "extreme"),
    [
        ("elasticity_pa_per_m = 510000000.0", "1e-300"),
        ("scale_per_n = 68.0", "1e300"),
        ("scale_per_n = 68.0", "68.0\nscale_per_taxel_per_n = [" + "1e300, " * 16 + "]"),
    ],
)
def test_what_no_skin_has_is_refused(tmp_path, figure, extreme):
    folder = edited(tmp_path, (figure, f"{figure.split(' =')[0]} = {extreme}"))
    key = "scale_per_taxel_per_n" if "taxel" in extreme else figure.split(" =")[0]
    assert [problem.place for problem in problems(folder)] == [f"{folder}/calibration.toml, [model] {key}"]


def test_every_fault_is_named_at_once(tmp_path):
    folder = edited(
        tmp_path,
        ('"skincal-calibration/1"', '"skincal-calibration/2"'),
        ("rows = 4", "rows = 0"),
        ('kind = "sphere"', 'kind = "ball"'),
        ("[model]\ny_m = 0.0235", "[model]\ny_m = 23.5\nx_m = 0.0"),
        ("elasticity_pa_per_m = 510000000.0", "elasticity_pa_per_m = -1.0"),
        ("0.02175", "0.2175"),
        ("236000000.0", '"soft"'),
        ("presses_used = 24", "presses_used = 2.5"),
        ('severity = "warning"', 'severity = "bad"'),
        ('name = "creep"', 'name = "creeep"'),
        ("dataset_sha256", "dataset_hash"),
        ("seed = 7", "seed = true"),
    )  # fmt: skip
    (folder / "draws.parquet").write_bytes(b"PAR1 and no more")
    lines = (folder / "slack.csv").read_text().splitlines()
    (folder / "slack.csv").write_text("\n".join([lines[0].replace("good", "fine"), *lines[1:]]))
    found = problems(folder)
    places = sorted(problem.place.removeprefix(f"{folder}/") for problem in found)
    assert all(problem.place.startswith(str(folder)) for problem in found)
    assert places == sorted(
        [
            "calibration.toml, format",
            "calibration.toml, [sensor] rows",
            "calibration.toml, [indenter] kind",
            "calibration.toml, [model] y_m",
            "calibration.toml, [model] x_m",
            "calibration.toml, [model] elasticity_pa_per_m",
            "calibration.toml, [intervals] y_m",
            "calibration.toml, [intervals] elasticity_pa_per_m",
            "calibration.toml, [loss] presses_used",
            "calibration.toml, [findings 1] severity",
            "calibration.toml, [effects 1] name",
            "calibration.toml, [provenance] dataset_sha256",
            "calibration.toml, [provenance] seed",
            "draws.parquet",
            "slack.csv",
        ]
    )
    text = "\n".join(map(str, found))
    assert "divide by 1000" in text
    assert 'Did you mean "creep"?' in text
    assert "a whole Parquet file" in text


@pytest.mark.parametrize(
    ("old", "new", "place"),
    [
        ("[model]", "[modle]", "calibration.toml, modle"),
        ("beta_deg = 2.1\n", "", "calibration.toml, [model] beta_deg"),
        ("[intervals]", "[intervals.x]", "calibration.toml, [intervals] y_m"),
        ("[loss]", "[[loss]]", "calibration.toml, [loss]"),
        ("[sensor]", "[sensor\n", "calibration.toml"),
        ("time = 2026", "time = 'now' #", "calibration.toml, [provenance] time"),
        ("scale_per_n = 68.0", "scale_per_n = 68.0\nscale_per_taxel_per_n = [1.0]",
         "calibration.toml, [model] scale_per_taxel_per_n"),
        ("time_constant_s = 2.0", 'time_constant_s = "two"',
         "calibration.toml, [effects 1] parameters.time_constant_s"),
        ("{ time_constant_s = 2.0 }", "{ time_constant_s = 2.0 }, intervals = { time_constant_s = [3.0, 1.0] }",
         "calibration.toml, [effects 1] intervals.time_constant_s"),
        ("{ time_constant_s = 2.0 }", "{ time_constant_s = 2.0 }, intervals = { tau = [1.0, 3.0] }",
         "calibration.toml, [effects 1] intervals.tau"),
    ],
)  # fmt: skip
def test_one_fault_is_named(tmp_path, old, new, place):
    folder = edited(tmp_path, (old, new))
    assert f"{folder}/{place}" in [problem.place for problem in problems(folder)]


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("time_constant_s = 2.0", "time_constant = 2.0",
         ["parameters.time_constant: expected one of amplitude, time_constant_s, breadth",
          'Did you mean "time_constant_s"?']),
        ("time_constant_s = 2.0", "amplitude = 9.0", ["parameters.amplitude: expected -0.6 to 1.5", "got 9"]),
        ("time_constant_s = 2.0", "amplitude = [0.1, 0.2]", ["parameters.amplitude: expected one number"]),
        ("time_constant_s = 2.0 }", 'time_constant_s = 2.0 }, poses = ["a"]', ["does not depend on the hand pose"]),
        ("time_constant_s = 2.0 }", 'time_constant_s = 2.0 }, poses = ["a", "a"]', ["poses, each once"]),
    ],
)  # fmt: skip
def test_what_an_effect_cannot_be_is_said(tmp_path, old, new, words):
    text = "\n".join(map(str, problems(edited(tmp_path, (old, new)))))
    assert "calibration.toml, [effects 1]" in text
    for word in words:
        assert word in text


@pytest.mark.parametrize(
    ("effect", "words"),
    [
        (Effect("taxel_gain", {"gain": (1.0, 0.9)}), r"gain: expected one number, or 16, one for each taxel"),
        (
            Effect("force_bias", {"pose_scale": (1.0, 1.1, 1.2)}, poses=("a", "b")),
            r"one for each of the poses",
        ),
        (Effect("dead_taxel", {"answer": (1.5,) * 16}), r"answer: expected 0 to 1 -; got 1.5"),
    ],
)
def test_lists_of_an_effect_have_their_size_and_bounds(tmp_path, effect, words):
    with pytest.raises(InputError, match=words):
        write_calibration(make_calibration(effects=(effect,)), tmp_path / "cal")


def test_an_effect_stands_there_once(tmp_path):
    twice = (Effect("creep", {"amplitude": 0.1}), Effect("creep", {"breadth": 1.0}))
    with pytest.raises(InputError, match=r"\[effects 2\] name: expected each effect once"):
        write_calibration(make_calibration(effects=twice), tmp_path / "cal")


def test_a_folder_of_something_else(tmp_path):
    assert problems(tmp_path / "none")[0].got == "no such folder"
    (tmp_path / "file").write_text("")
    assert problems(tmp_path / "file")[0].got == "a file"
    assert "Is this a calibration's folder?" in str(problems(tmp_path)[0])


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"draws": {"y_m": np.array([0.1, np.nan])}}, "draws.parquet, column y_m, row 2"),
        ({"draws": {"y": np.array([0.1])}}, "draws.parquet: expected columns y_m"),
        ({"draws": {"effects.creep.tau": np.array([0.1])}}, "draws.parquet: expected columns y_m"),
        ({"draws": {"y_m": np.array([])}}, "one draw or more"),
        ({"draws": {"y_m": np.array([1.0]), "beta_deg": np.array([1.0, 2.0])}}, "columns of one length"),
        ({"slack": {"press": np.array([0])}}, "slack.csv: expected the 9 columns used, reason"),
        ({"slack": make_slack() | {"used": np.array([1, 1, 0])}}, "column used: expected true or false"),
        (
            {"slack": make_slack() | {"residual_rms_counts": np.array([1.0, -1, 0])}},
            "residual_rms_counts, row 2",
        ),
        ({"model": ModelParameters(0.0235, 0.0, np.nan, 68.0, beta_deg=0.0)}, r"\[model\] elasticity"),
        ({"model": ModelParameters(0.0235, 0.0, 5e8, 68.0, x_m=0.0)}, r"\[model\] beta_deg"),
        ({"intervals": {}}, r"\[intervals\] scale_per_n"),
        ({"effects": (Effect("sticky"),)}, r"\[effects 1\] name"),
    ],
)
def test_what_could_not_be_read_back_is_not_written(tmp_path, changes, words):
    with pytest.raises(InputError, match=words):
        write_calibration(make_calibration(**changes), tmp_path / "cal")
    assert list(tmp_path.iterdir()) == []


def test_nothing_is_overwritten_without_force(tmp_path):
    write_calibration(make_calibration(), tmp_path / "cal")
    with pytest.raises(InputError, match="--force"):
        write_calibration(on_a_plane(), tmp_path / "cal")
    assert read_calibration(tmp_path / "cal").surface.kind == "cylinder"
    write_calibration(on_a_plane(), tmp_path / "cal", force=True)
    back = read_calibration(tmp_path / "cal")
    assert back.surface.kind == "plane"
    assert back.draws is None


def test_a_report_comes_along_or_nothing_does(tmp_path):
    write_calibration(
        make_calibration(), tmp_path / "cal", beside=lambda f: (f / "r.html").write_text("ok") and None
    )
    assert (tmp_path / "cal" / "r.html").read_text() == "ok"

    def fails(folder):
        (folder / "r.html").write_text("half")
        raise OSError(28, "No space left on device")

    with pytest.raises(OSError, match="No space"):
        write_calibration(make_calibration(), tmp_path / "other", beside=fails)
    with pytest.raises(OSError, match="No space"):
        write_calibration(on_a_plane(), tmp_path / "cal", force=True, beside=fails)
    assert read_calibration(tmp_path / "cal").surface.kind == "cylinder"
    assert [p.name for p in tmp_path.iterdir()] == ["cal"]


def test_the_level_at_rest_goes_through_the_file(tmp_path):
    plain = make_calibration()
    with_rest = replace(
        plain,
        model=replace(plain.model, rest_counts=25.0),
        intervals={**plain.intervals, "rest_counts": (24.9, 25.1)},
    )
    write_calibration(with_rest, tmp_path / "cal")
    back = read_calibration(tmp_path / "cal")
    assert back.model.rest_counts == 25.0
    assert back.intervals["rest_counts"] == (24.9, 25.1)
    assert not back.warnings
    assert "rest_counts" not in back.model.best()


def test_a_file_without_a_level_at_rest_is_read(tmp_path):
    write_calibration(make_calibration(), tmp_path / "cal")
    assert read_calibration(tmp_path / "cal").model.rest_counts is None
