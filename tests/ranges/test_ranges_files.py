"""Files: exact in all three formats, whole or not at all, and every fault named with its place."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from skincal.errors import InputError
from skincal.ranges import JointDraws, Parameter, Ranges, preset, read_ranges, write_ranges
from skincal.ranges.parameter import DISTRIBUTIONS

SUFFIXES = (".toml", ".json", ".yaml", ".yml")
NUMBERS = st.floats(-1e300, 1e300, allow_nan=False)
POSITIVE = st.floats(1e-300, 1e300)


WIDE = (
    "skin.scale_per_n",
    "skin.elasticity_pa_per_m",
    "object.marble.random_force_n",
    "skin.scale_offset_per_n",
)
"""Parameters with few bounds or none; of the last, one number a taxel."""


@st.composite
def parameters(draw, least: float):
    mode = draw(st.sampled_from(["episode", "step"]))
    source = draw(st.sampled_from(["calibrated", "assumed"]))
    kind = draw(st.sampled_from(list(DISTRIBUTIONS)))
    if kind == "normal":
        return Parameter.normal(max(draw(NUMBERS), least), draw(POSITIVE), mode, source)
    if kind == "constant":
        return Parameter.constant(max(draw(NUMBERS), least), mode, source)
    low, high = sorted([draw(POSITIVE), draw(POSITIVE)])
    return getattr(Parameter, kind)(low, high, mode, source)


LISTS = st.lists(NUMBERS, min_size=1, max_size=4).map(lambda lows: Parameter.uniform(tuple(lows), 1e300))


@pytest.mark.parametrize("suffix", SUFFIXES[:3])
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=30)
@given(
    values=st.fixed_dictionaries(
        {},
        optional={
            WIDE[0]: parameters(0.0),
            WIDE[1]: parameters(0.0),
            WIDE[2]: parameters(-1e300),
            WIDE[3]: parameters(-1e300) | LISTS,
            "skin.effects.creep.amplitude": st.floats(-0.6, 1.5).map(Parameter.constant),
            "skin.effects.taxel_gain.gain": st.lists(st.floats(0.2, 5.0), min_size=1, max_size=4).map(
                lambda lows: Parameter.uniform(tuple(lows), 5.0)
            ),
        },
    ),
    rows=st.lists(st.tuples(NUMBERS, NUMBERS), max_size=4),
)
def test_what_is_written_is_read_exactly(tmp_path, suffix, values, rows):
    joint = JointDraws(("skin.y_m", "skin.effects.creep.amplitude"), rows) if rows else None
    ranges = Ranges(values, joint, {"dataset": 'a "quoted" näme\n'})
    path = tmp_path / f"ranges{suffix}"
    write_ranges(ranges, path, force=True)
    assert read_ranges(path) == ranges


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("name", ["iros24", "icra26"])
def test_presets_come_back(tmp_path, suffix, name):
    path = tmp_path / f"r{suffix}"
    write_ranges(preset(name), path)
    back = read_ranges(path)
    assert back == preset(name)
    one, two = (r.sample(np.random.default_rng(4)) for r in (back, preset(name)))
    assert one["skin"]["alpha_deg"] == two["skin"]["alpha_deg"]


def test_the_file_is_the_contracts(tmp_path):
    path = tmp_path / "ranges.toml"
    calibrated = Parameter.uniform(2.36e8, 8.48e8, source="calibrated")
    write_ranges(preset("iros24").replace({"skin.elasticity_pa_per_m": calibrated}), path)
    text = path.read_text()
    assert text.startswith('format = "skincal-ranges/1"\n')
    assert (
        "[skin.elasticity_pa_per_m]\n"
        'distribution = "uniform"\n'
        "low = 236000000.0\n"
        "high = 848000000.0\n"
        'mode = "episode"\n'
        'source = "calibrated"\n'
    ) in text


def test_a_cloud_takes_one_line_a_draw(tmp_path):
    rows = np.random.default_rng(0).normal(0.02, 1e-3, (50, 2))
    ranges = Ranges(preset("iros24"), JointDraws(("skin.y_m", "skin.alpha_deg"), rows))
    write_ranges(ranges, tmp_path / "r.toml")
    lines = (tmp_path / "r.toml").read_text().splitlines()
    assert sum(line.startswith("    [") for line in lines) == 50
    assert read_ranges(tmp_path / "r.toml") == ranges


def test_a_person_may_write_numbers_as_they_like(tmp_path):
    table = "{distribution: uniform, low: 2e8, high: 8.5E8, mode: episode, source: assumed}"
    path = tmp_path / "r.yaml"
    path.write_text(f"format: skincal-ranges/1\nskin:\n  elasticity_pa_per_m: {table}\n")
    assert read_ranges(path)["skin.elasticity_pa_per_m"] == Parameter.uniform(2e8, 8.5e8)


BAD = """
format = "skincal-ranges/1"
colour = "red"

[skin]
alpha_deg = 3.0

[skin.y_m]
distribution = "uniform"
low = 0.03
high = 0.02
mode = "episode"
source = "calibrated"

[skin.beta_dge]
distribution = "uniform"
low = 0.0
high = 1.0
mode = "episode"
source = "assumed"

[skin.scale_per_n]
distribution = "uniformly"
low = 61
high = 76
mode = "episode"
source = "assumed"

[skin.elasticity_pa_per_m]
distribution = "log_uniform"
low = 0.0
high = "many"
mode = "evening"
source = "assumed"

[skin.noise_sigma_counts]
distribution = "uniform"
low = 0
mode = "step"
hihg = 3

[skin.taxel_noise_counts]
distribution = "normal"
mean = 0
sigma_from = "skin.noise_sigma_counts"
mode = "step"
source = "assumed"

[object.cube.mass_kg]
distribution = "constant"
value = 1
mode = "episode"
source = "assumed"

[skin.joint]
columns = ["y_m", "beta"]
draws = [[0.1, 1.0], [0.2]]
"""


def test_every_fault_of_a_file_is_named_with_its_place(tmp_path):
    path = tmp_path / "ranges.toml"
    path.write_text(BAD)
    with pytest.raises(InputError) as caught:
        read_ranges(path)
    places = [problem.place for problem in caught.value.problems]
    assert sorted(places) == sorted(
        f"ranges.toml, {place}"
        for place in (
            "colour",
            "[skin.alpha_deg]",
            "[skin.y_m] low",
            "[skin.beta_dge]",
            "[skin.scale_per_n] distribution",
            "[skin.elasticity_pa_per_m] high",
            "[skin.elasticity_pa_per_m] mode",
            "[skin.noise_sigma_counts] hihg",
            "[skin.noise_sigma_counts] source",
            "[skin.noise_sigma_counts] high",
            "[object.cube]",
            "[skin.joint] draws",
        )
    )
    text = str(caught.value)
    words = ", ".join(f'"{name}"' for name in DISTRIBUTIONS)
    assert f'one of {words}; got "uniformly". Did you mean "uniform"?' in text
    assert 'one of "episode", "step"; got "evening"' in text


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("r.toml", 'format = "skincal-ranges/1"\n[skin\n', "line 2"),
        ("r.json", '{"format": ', "line 1 column"),
        ("r.yaml", "format: [", "line 1"),
        ("r.json", "[1, 2]", "a list"),
        ("r.yaml", "", "NoneType"),
        ("r.json", '{"format": "skincal-ranges/1", "format": "x"}', "the key format twice"),
        ("r.yaml", "format: a\nformat: b\n", "the key format twice"),
        ("r.yaml", "format: !!python/object/apply:os.getcwd []\n", "constructor"),
        ("r.toml", 'format = "skincal-dataset/1"\n', "skincal-ranges/1"),
        ("r.toml", "", "format: expected"),
        ("r.json", '{"format": "skincal-ranges/1", "skin": 3}', "skin: expected a table"),
        ("r.json", '{"format": "skincal-ranges/1", "provenance": {"a": 1}}', "a table of texts"),
        (
            "r.toml",
            'format = "skincal-ranges/1"\n[skin.joint]\ncolumns = []\ndraws = []\n',
            "rows of numbers",
        ),
    ],
)
def test_a_file_that_is_none_is_refused(tmp_path, name, text, words):
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=words):
        read_ranges(tmp_path / name)


@pytest.mark.parametrize("number", ["true", "NaN", "Infinity", "1" + "0" * 400])
def test_figures_must_be_finite_numbers(tmp_path, number):
    table = f'{{"distribution": "constant", "value": {number}, "mode": "episode", "source": "assumed"}}'
    (tmp_path / "r.json").write_text(f'{{"format": "skincal-ranges/1", "skin": {{"y_m": {table}}}}}')
    with pytest.raises(InputError, match=r"skin\.y_m\W+value"):
        read_ranges(tmp_path / "r.json")


def test_files_that_are_not_there_or_no_files(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        read_ranges(tmp_path / "missing.toml")
    (tmp_path / "folder.toml").mkdir()
    with pytest.raises(InputError, match="is a directory"):
        read_ranges(tmp_path / "folder.toml")
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="UTF-8"):
        read_ranges(tmp_path / "binary.toml")
    with pytest.raises(InputError, match=r"\.toml, \.json, \.yaml, \.yml"):
        read_ranges(tmp_path / "ranges.ini")


def test_nothing_is_overwritten_without_force(tmp_path):
    path = tmp_path / "ranges.json"
    write_ranges(preset("iros24"), path)
    before = path.read_bytes()
    with pytest.raises(InputError, match="--force"):
        write_ranges(preset("icra26"), path)
    assert path.read_bytes() == before
    write_ranges(preset("icra26"), path, force=True)
    assert json.loads(path.read_text())["provenance"] == {"preset": "icra26"}
    assert [p.name for p in tmp_path.iterdir()] == ["ranges.json"]


def test_a_full_disk_leaves_what_was_there(tmp_path, monkeypatch):
    path = tmp_path / "ranges.toml"
    write_ranges(preset("iros24"), path)

    def full(self, text, encoding):
        self.write_bytes(text[:100].encode())
        raise OSError(28, "No space left on device", str(self))

    monkeypatch.setattr(Path, "write_text", full)
    with pytest.raises(OSError, match="No space"):
        write_ranges(preset("icra26"), path, force=True)
    assert read_ranges(path) == preset("iros24")
    assert [p.name for p in tmp_path.iterdir()] == ["ranges.toml"]


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_byte_order_mark_is_no_fault(tmp_path, suffix):
    """Some editors put it at the beginning of every text."""
    path = tmp_path / f"ranges{suffix}"
    write_ranges(preset("iros24"), path)
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    assert read_ranges(path) == preset("iros24")
