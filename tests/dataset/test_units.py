"""Values that cannot be meant: overflown and swapped words, units that are off by a factor."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from typer.testing import CliRunner

from skincal.cli.main import app
from skincal.dataset import (
    Dataset,
    MountSpec,
    Presses,
    SurfaceSpec,
    check_dataset,
    read_dataset,
    write_dataset,
)  # fmt: skip
from skincal.dataset.unit_checks import expected_load, force_units, unit_of_ratio, value_step
from skincal.dataset.word_checks import (
    as_word,
    bytes_swapped,
    find_below_zero,
    find_byte_order,
    find_falls,
    find_wrapped,
    swapped,
)  # fmt: skip
from tests.dataset.changes import loads, with_presses, with_sensor

Session = Callable[..., Dataset]
ROOT = Path(__file__).parents[2]
SHARED = ROOT.parent / "shared"


@pytest.fixture
def original() -> Dataset:
    return read_dataset(ROOT / "data" / "paper-like")


def changed(dataset: Dataset, counts: np.ndarray | None = None, force: float = 1.0, **sensor: Any) -> Dataset:
    """The dataset with other taxel values, forces times a factor, and another ``[sensor]``."""
    free = {"value_min": None, "value_max": None} if counts is not None else {}
    counts = dataset.presses.counts if counts is None else counts
    moved = with_presses(dataset, counts=counts, force_n=dataset.presses.force_n * force)
    return with_sensor(moved, **{**free, **sensor})


def found(folder: Path, dataset: Dataset) -> list[Any]:
    folder.mkdir(exist_ok=True)
    write_dataset(dataset, folder / "set")
    checked = check_dataset(folder / "set")
    return [problem for problem in (*checked.errors, *checked.warnings) if problem.code]


def words_16(dataset: Dataset, rest: float = 30000.0, gain: float = 30.0) -> np.ndarray:
    rng = np.random.default_rng(4)
    counts = dataset.presses.counts
    levels = rest + rng.integers(0, 1500, counts.shape[1])
    return np.rint(levels + gain * counts + rng.normal(0, 4, counts.shape))


def test_signed_words_that_overflow(tmp_path: Path, original: Dataset):
    true = words_16(original)
    stored = as_word(true, "int16")
    (problem,) = found(tmp_path, changed(original, stored))
    assert problem.code == "counter_wrapped"
    assert problem.details["modulus"] == 65536
    assert problem.got.startswith(f"{int((stored < 0).sum())} readings at the other end of 16 bits")
    assert problem.details["mapping"] == '[taxels] word = "uint16"'
    np.testing.assert_array_equal(as_word(stored, "uint16"), true)


def test_signed_words_that_fill_their_range(tmp_path: Path, original: Dataset):
    """A sensor that rests at zero: what lies between the ends is full of readings, and the load tells."""
    counts = np.rint(1.4 * original.presses.counts)
    (problem,) = found(tmp_path, changed(original, as_word(counts, "int8")))
    assert problem.code == "counter_wrapped" and problem.details["mapping"] == '[taxels] word = "uint8"'


@pytest.mark.parametrize("bits", [8, 12, 24])
def test_words_of_other_widths(bits: int, original: Dataset):
    size = 2.0**bits
    true = np.rint(0.42 * size + original.presses.counts * size / 600)
    wrapped = find_wrapped(as_word(true, f"int{bits}"))
    assert wrapped is not None and wrapped.bits == bits and wrapped.word == f"uint{bits}"
    assert wrapped.readings == int((true >= size / 2).sum())


def test_unsigned_words_at_both_ends(original: Dataset):
    rng = np.random.default_rng(0)
    high = np.rint(60000 + 60 * original.presses.counts)
    over = find_wrapped(as_word(high, "uint16"))
    assert over is not None and over.word == "int16" and over.readings == int((high > 65535).sum())
    np.testing.assert_array_equal(as_word(as_word(high, "uint16"), over.word), high - 65536)
    loads = original.presses.counts - np.median(original.presses.counts)
    rest = np.rint(20 * loads + rng.normal(0, 2, original.presses.counts.shape))
    under = find_wrapped(as_word(rest, "uint16"))
    assert under is not None and under.word == "int16"


@pytest.mark.parametrize(("rest", "gain"), [(65400.0, 9.0), (65500.0, 20.0), (65530.0, 3.0)])
def test_words_that_rest_just_below_their_top(tmp_path: Path, rest: float, gain: float, original: Dataset):
    """No falling sensor: what goes on at the lower end is as far apart as loads are."""
    noise = np.random.default_rng(2).normal(0, 1, original.presses.counts.shape)
    true = np.rint(rest + gain * original.presses.counts + noise)
    (problem,) = found(tmp_path, changed(original, as_word(true, "uint16")))
    assert problem.code == "counter_wrapped" and problem.details["mapping"] == '[taxels] word = "int16"'
    # Readings that drop out to nothing are none.
    dropped = np.where(np.random.default_rng(3).random(true.shape) < 0.02, 0.0, np.minimum(true, 65535))
    assert find_wrapped(dropped) is None


def near_zero(dataset: Dataset, rest: float, gain: float = 1.0) -> np.ndarray:
    """Readings of a sensor that rests so many counts above zero, before they are words; noise of one count."""
    noise = np.random.default_rng(5).normal(0, 1, dataset.presses.counts.shape)
    return np.rint(rest + gain * loads(dataset) + noise)


@pytest.mark.parametrize("bits", [8, 12, 16])
@pytest.mark.parametrize("rest", [2.0, 1.0, 0.0])
def test_few_words_below_zero(tmp_path: Path, bits: int, rest: float, original: Dataset):
    true = near_zero(original, rest, 100 / original.presses.counts.max())
    below = int((true < 0).sum())
    (problem, *others) = found(tmp_path, changed(original, np.mod(true, 2.0**bits)))
    assert below > 1 and problem.code == "counter_wrapped"
    assert problem.got.startswith(f"{below} readings at the other end of {bits} bits, with nothing between")
    assert problem.details["mapping"] == f'[taxels] word = "int{bits}"'
    np.testing.assert_array_equal(as_word(np.mod(true, 2.0**bits), f"int{bits}"), true)
    assert not any("dropped out" in other.got for other in others)


def test_words_below_zero_among_loads_that_fill_them(tmp_path: Path, original: Dataset):
    """Places and forces tell that what lies at the top is not pressed; a sensor that saturates there is."""
    true = near_zero(original, 1.0, 240 / original.presses.counts.max())
    assert true.max() < 252
    (problem,) = found(tmp_path, changed(original, np.mod(true, 256)))
    assert problem.code == "counter_wrapped" and not problem.details["mapping"]
    assert "take 256 off those of 252 or more" in problem.fix
    for gain in (1.5, 3.0):
        saturated = np.clip(near_zero(original, 1.0, gain * 240 / original.presses.counts.max()), 0, 255)
        assert (saturated == 255).sum() > 1
        assert find_below_zero(saturated, expected_load(original)) is None


@pytest.mark.parametrize("rest", [0.0, 6.0, 20.0])
def test_drop_outs_to_full_scale_are_no_words_below_zero(rest: float, original: Dataset):
    true = np.maximum(near_zero(original, rest, 100 / original.presses.counts.max()), 0)
    dropped = np.random.default_rng(3).random(true.shape) < 0.01
    assert find_below_zero(true) is None
    assert find_below_zero(np.where(dropped, 65535.0, true)) is None


def test_frames_below_zero_at_rest():
    """Loads fill words of eight bits, so that only frames at rest tell what lies at their top."""
    rng = np.random.default_rng(7)
    share = np.concatenate([np.zeros(6), np.linspace(0.1, 1, 5), np.ones(5)])
    force = np.tile(share, 20) * np.repeat(rng.uniform(1, 4, 20), len(share))
    gain = rng.uniform(0, 60, (20, 4)).repeat(len(share), axis=0) * (rng.random((20, 4)) < 0.4).repeat(
        16, axis=0
    )
    true = np.rint(1.0 + gain * force[:, None] + rng.normal(0, 1, gain.shape))
    load = np.broadcast_to(force[:, None], true.shape)
    assert 128 < true.max() < 252
    wrapped = find_below_zero(np.mod(true, 256), load)
    assert wrapped is not None and wrapped.readings == int((true < 0).sum())
    assert find_below_zero(np.clip(true * 2, 0, 255), load) is None


def test_bytes_in_the_wrong_order(tmp_path: Path, original: Dataset):
    true = words_16(original, 20000.0, 10.0)
    (problem,) = found(tmp_path, changed(original, swapped(true)))
    assert problem.code == "bytes_swapped"
    np.testing.assert_array_equal(swapped(swapped(true)), true)


@pytest.mark.parametrize("swap_bytes", [False, True])
def test_halves_of_32_bits_in_the_wrong_order(tmp_path: Path, original: Dataset, swap_bytes: bool):
    true = words_16(original, 70000.0, 900.0)
    stored = as_word(swapped(true, swap_bytes=swap_bytes, swap_words=True), "int32")
    (problem,) = found(tmp_path, changed(original, stored))
    assert problem.code == "bytes_swapped"
    lines = problem.details["mapping"]
    assert (
        ("swap_bytes = true" in lines) == swap_bytes
        and "swap_words = true" in lines
        and "word =" not in lines
    )
    np.testing.assert_array_equal(swapped(stored, swap_bytes=swap_bytes, swap_words=True), true)


@pytest.mark.parametrize(("rest", "gain"), [(10.0, 5.0), (20000.0, 100.0)])
def test_four_reversed_bytes_of_small_values(tmp_path: Path, original: Dataset, rest: float, gain: float):
    """Below 65536 the lower half is always zero: what is left is two swapped bytes."""
    true = words_16(original, rest, gain)
    stored = swapped(true, swap_words=True)
    assert true.max() < 65536
    (problem,) = found(tmp_path, changed(original, stored))
    assert problem.code == "bytes_swapped"
    assert problem.details["mapping"].endswith("swap_bytes = true, swap_words = true")
    assert not find_byte_order(true * 2**16)  # shifted up only


def test_packed_words_are_no_swapped_bytes(original: Dataset):
    """Four values of 12 bits in three words of 16: an order of bytes mends some taxels only."""
    true = np.rint(words_16(original, 200.0, 8.0)).clip(0, 4095).astype(np.int64)
    a, b, c, d = (true[:, i::4] for i in range(4))
    packed = np.stack([a << 4 | b >> 8, (b & 255) << 8 | c >> 4, (c & 15) << 12 | d], axis=2)
    assert not find_byte_order(packed.reshape(len(true), -1).astype(float))


@pytest.mark.parametrize("factor", [1e-3, 0.1, 10.0])
def test_positions_in_another_unit_on_a_plane(tmp_path: Path, original: Dataset, factor: float):
    """Too small or too large for the images, though near the patch."""
    rng, centres = np.random.default_rng(2), original.layout().centres_m
    place = rng.uniform(-7e-3, 7e-3, (40, 2))
    force, away = rng.uniform(1, 4, 40), np.linalg.norm(place[:, None] - centres, axis=2)
    counts = np.rint(60 * force[:, None] * np.exp(-((away / 3e-3) ** 2)))
    mount = MountSpec(0.0, 0.0, (-3e-3, 3e-3), (-15, 15), x_m=0.0, x_range_m=(-3e-3, 3e-3))
    position = np.column_stack([place, np.zeros(40)])
    meta = replace(original.meta, surface=SurfaceSpec("plane"), mount=mount)
    right = replace(original, meta=meta, presses=Presses(np.arange(40), position, force, counts))
    assert not found(tmp_path, right)
    wrong = replace(right, presses=replace(right.presses, position_m=position * factor))
    (tmp_path / "b").mkdir()
    (problem,) = found(tmp_path / "b", wrong)
    assert problem.code == "unit_suspect" and problem.details["factor"] * factor == pytest.approx(1.0)


def test_swapped_bytes_of_words_that_fill_their_range(original: Dataset):
    """High bytes change under load and low bytes by noise: the range is whole in either order, rest is not."""
    load = loads(original)
    noise = np.random.default_rng(4).normal(0, 30, load.shape)
    true = np.rint(20000 + load * (45000 / load.max()) + noise).clip(0, 65535)
    assert bytes_swapped(swapped(true)) == "uint16"
    assert not bytes_swapped(true)


def test_words_that_pass_their_top_among_others(tmp_path: Path, original: Dataset):
    """A sensor that rests at 90 of 255 counts: what wrapped lies among the others, but for some below rest."""
    load = loads(original)
    true = np.rint(90 + load * (240 / load.max()) + np.random.default_rng(4).normal(0, 1, load.shape))
    assert ((true > 255) & (true < 255 + 80)).sum() > 5
    (problem,) = found(tmp_path, changed(original, np.mod(true, 256), value_min=None, value_max=None))
    assert problem.code == "counter_wrapped" and "press with less force" in problem.fix
    # One that clips there, and readings that drop out, are none.
    dropped = np.random.default_rng(3).random(true.shape) < 0.03
    assert find_wrapped(np.where(dropped, 0, np.minimum(true, 255)), expected_load(original)) is None


def test_words_that_pass_their_top_from_frame_to_frame():
    """A sensor that rests at 9000 of 65535: what wrapped is higher than rest or lower, and no gap separates it."""
    rng = np.random.default_rng(6)
    share = np.concatenate([np.zeros(4), np.linspace(0.1, 1, 8), np.ones(5), np.linspace(1, 0.1, 8)])
    press = np.concatenate([np.where(share > 0, k, -1) for k in range(20)])
    force = np.tile(share, 20) * np.repeat(rng.uniform(1, 4, 20), len(share))
    gain = rng.uniform(0, 22000, (20, 4)).repeat(len(share), axis=0)
    true = np.rint(9000 + gain * force[:, None] + rng.normal(0, 5, gain.shape))
    wrapped = find_falls(np.mod(true, 65536), press, force)
    assert wrapped is not None and wrapped.bits == 16 and "less force" in wrapped.mend
    # One that clips there, readings that drop out to a constant, and such that drop to rest, are none.
    clipped = np.minimum(true, 65535)
    assert find_falls(clipped, press, force) is None
    lost = rng.random(true.shape) < 0.03
    assert find_falls(np.where(lost, 0, clipped), press, force) is None
    assert find_falls(np.where(lost, 9000 + rng.integers(-9, 9, true.shape), clipped), press, force) is None


@pytest.mark.parametrize(("rest", "word"), [(20000.0, "uint16"), (600.0, "uint16"), (0.0, "int16")])
@pytest.mark.parametrize("signed", [False, True])
def test_swapped_bytes_of_signed_words(
    rest: float, word: str, signed: bool, tmp_path: Path, original: Dataset
):
    """Words that are read as signed ones, and values about zero as a driver that subtracts writes them."""
    loads = original.presses.counts - np.median(original.presses.counts)
    true = np.rint(rest + loads + np.random.default_rng(3).normal(0, 2, loads.shape))
    stored = as_word(swapped(as_word(true, "uint16")), "int16" if signed else "uint16")
    (problem,) = found(tmp_path, changed(original, stored))
    assert problem.code == "bytes_swapped"
    assert ('word = "int16"' in problem.details["mapping"]) == (word == "int16")
    np.testing.assert_array_equal(as_word(swapped(as_word(stored, "uint16")), word), true)


@pytest.mark.parametrize("rest", [0.0, 100.0, 20000.0])
@pytest.mark.parametrize("gain", [1.0, 10.0, 64.0, 256.0])
def test_good_words_are_good(rest: float, gain: float, original: Dataset):
    """Values of 8 bits, of more, and such as are shifted up in their words."""
    counts = np.rint(rest + original.presses.counts) * gain if gain >= 64 else words_16(original, rest, gain)
    counts = np.clip(counts, 0, 65535)
    assert find_wrapped(counts) is None
    assert not bytes_swapped(counts)


@pytest.mark.parametrize(("unit", "scale"), [("V", 1e-3), ("V", 3.3 / 256), ("1", 1 / 256)])
def test_small_values_are_no_counts(tmp_path: Path, original: Dataset, unit: str, scale: float):
    counts = original.presses.counts * scale
    (problem,) = found(tmp_path, changed(original, counts, integer=True))
    assert problem.code == "unit_suspect" and problem.severity == "warning"
    assert "[sensor] unit" in problem.details["mapping"]
    (problem,) = found(tmp_path / "b", changed(original, counts, integer=False))
    assert problem.severity == "note"
    # With its unit all is well, and nobody asks whether counts grow with load.
    write_dataset(changed(original, counts, integer=False, unit=unit), tmp_path / "c")
    checked = check_dataset(tmp_path / "c")
    assert not checked.warnings
    assert checked.dataset is not None and checked.dataset.meta.sensor.unit == unit


def test_step_of_a_converter(original: Dataset):
    assert value_step(np.rint(original.presses.counts) * 3.3 / 4096) == pytest.approx(3.3 / 4096)
    assert (
        value_step(original.presses.counts * 1e-3 + np.random.default_rng(0).normal(0, 1e-4, (60, 16)))
        is None
    )


@pytest.mark.parametrize("baseline", ["raw", "subtracted"])
def test_falling_sensor(tmp_path: Path, original: Dataset, baseline: str):
    counts = (240.0 if baseline == "raw" else 0.0) - original.presses.counts
    problem, _ = found(tmp_path, changed(original, counts, baseline=baseline))  # no taxel rises, too
    assert problem.code == "unit_suspect" and problem.details["factor"] == -1.0
    assert "falling_from" in problem.fix


def test_falling_sensor_with_noise_and_its_rest_subtracted(tmp_path: Path, original: Dataset):
    load = loads(original)
    counts = np.random.default_rng(1).normal(0, 1, load.shape) - 3 * load
    problem, _ = found(tmp_path, changed(original, counts, baseline="subtracted", integer=False))
    assert problem.code == "unit_suspect" and "falling_from = 0" in problem.fix


def test_small_values_that_are_no_whole_numbers_are_active(tmp_path: Path, original: Dataset):
    """Kilopascals up to 8: five of them are no threshold."""
    write_dataset(changed(original, original.presses.counts / 30, integer=False), tmp_path / "set")
    assert not [
        problem for problem in check_dataset(tmp_path / "set").warnings if "in any press" in problem.got
    ]


def test_busy_falling_sensor(tmp_path: Path, original: Dataset):
    """Most presses touch most taxels: the level at rest is not to be seen, the load tells."""
    counts = 800.0 - np.rint(100 * expected_load(original) ** 0.5)
    (problem,) = found(tmp_path, changed(original, counts))
    assert problem.details["factor"] == -1.0


def test_creep_at_one_place_is_no_falling_sensor(tmp_path: Path, original: Dataset):
    """Values grow from press to press while the force gives way, all of them above rest."""
    force = np.linspace(3.0, 2.0, len(original.presses))
    place = np.repeat(original.presses.position_m[:1], len(force), axis=0)
    counts = np.rint(200.0 - 30.0 * force[:, None] + np.arange(original.presses.counts.shape[1]))
    at_one_place = with_presses(original, position_m=place, force_n=force)
    creeping = changed(at_one_place, counts, baseline="subtracted")
    assert not [problem for problem in found(tmp_path, creeping) if problem.details.get("factor") == -1.0]


@pytest.mark.parametrize(
    ("factor", "unit"),
    [
        (1 / 9.80665e-3, "grams-force"),
        (1 / 9.80665, "kilograms-force"),
        (1e3, "millinewtons"),
        (1e-3, "kilonewtons"),
    ],
)
def test_force_in_another_unit(tmp_path: Path, original: Dataset, factor: float, unit: str):
    (problem,) = found(tmp_path, changed(original, force=factor))
    assert problem.code == "unit_suspect"
    assert unit in problem.fix
    assert problem.details["factor"] == pytest.approx(1 / factor)


def test_force_of_the_wrong_sign(tmp_path: Path, original: Dataset):
    (problem,) = found(tmp_path, changed(original, force=-1.0))
    assert problem.code == "unit_suspect" and problem.details["factor"] == -1.0


@pytest.mark.parametrize("factor", [9.80665e-3, 9.80665, 1e-3, 4.4482216])
def test_frames_in_another_unit_than_presses(tmp_path: Path, session: Session, factor: float):
    dataset = session(12)
    assert dataset.frames is not None
    frames = replace(dataset.frames, force_n=dataset.frames.force_n / factor)
    assert [p.details["factor"] for p in found(tmp_path, replace(dataset, frames=frames)) if p.code] == [
        pytest.approx(factor)
    ]
    assert unit_of_ratio(1.0) is None and unit_of_ratio(1.3) is None


def test_usual_forces_are_not_doubted():
    area = np.pi * 0.006**2
    assert all(not force_units(force, area) for force in (0.5, 1.0, 3.0, 20.0, 50.0))


@pytest.mark.parametrize(
    ("unit", "factor"),
    [("millimetres", 1e-3), ("centimetres", 0.01), ("inches", 0.0254), ("micrometres", 1e-6)],
)
def test_units_of_length(tmp_path: Path, original: Dataset, unit: str, factor: float):
    position = original.presses.position_m / factor
    (problem,) = found(tmp_path, with_presses(original, position_m=position))
    assert problem.code == "unit_suspect" and problem.details["factor"] == factor and unit in problem.fix


def test_places_of_another_frame_are_in_no_other_unit(tmp_path: Path, original: Dataset):
    tool = original.presses.position_m + np.array([0.0, 0.0, 0.12])
    write_dataset(with_presses(original, position_m=tool), tmp_path / "set")
    checked = check_dataset(tmp_path / "set")
    (problem,) = [one for one in (*checked.errors, *checked.warnings) if "contact points" in one.expected]
    assert not problem.code and "fingertip frame" in problem.fix


@pytest.mark.parametrize(
    ("unit", "factor"), [("centimetres", 0.01), ("inches", 0.0254), ("millimetres", 1e-3)]
)
def test_images_tell_the_unit_of_places_round_the_origin(
    tmp_path: Path, original: Dataset, unit: str, factor: float
):
    """On a pad every unit that is large enough brings all presses near the patch."""
    rng = np.random.default_rng(1)
    place = np.column_stack([rng.uniform(-8e-3, 8e-3, (40, 2)), np.zeros(40)])
    grid = np.array([[4e-3 * (c - 1.5), 4e-3 * (r - 1.5)] for r in range(4) for c in range(4)])
    away = np.linalg.norm(place[:, None, :2] - grid, axis=2)
    force = rng.uniform(1, 4, 40)
    counts = np.rint(60 * force[:, None] * np.exp(-((away / 3e-3) ** 2)))
    mount = MountSpec(0.0, 0.0, (-3e-3, 3e-3), (-15, 15), x_m=0.0, x_range_m=(-3e-3, 3e-3))
    pad = {"surface": SurfaceSpec("plane"), "mount": mount}
    presses = Presses(np.arange(40), place / factor, force, counts)
    (problem,) = found(tmp_path, Dataset(replace(original.meta, **pad), presses))
    assert problem.details["factor"] == factor and unit in problem.fix


def test_units_that_magnitude_does_not_tell_apart(tmp_path: Path, original: Dataset):
    (problem,) = found(tmp_path, changed(original, force=1e5))
    assert problem.details["factor"] == 1e-5 and "dynes" in problem.fix
    area = np.pi * 0.006**2
    assert list(force_units(0.25, area))[:1] == ["kilograms-force"] and "pounds-force" in force_units(
        0.25, area
    )


def test_findings_stand_in_the_json(tmp_path: Path, original: Dataset):
    write_dataset(changed(original, as_word(words_16(original), "int16")), tmp_path / "set")
    done = CliRunner().invoke(app, ["dataset", "check", str(tmp_path / "set"), "--json"])
    (finding,) = json.loads(done.stdout)["findings"]
    assert {"code", "severity", "text", "advice"} <= set(finding)
    assert finding["code"] == "counter_wrapped" and finding["severity"] == "warning"


def test_unit_of_values_is_kept_and_shown(tmp_path: Path, original: Dataset, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("skincal.report.dataset.dataset_figure", lambda *_: Figure())
    write_dataset(
        changed(original, original.presses.counts * 1e-3, unit="V", integer=False), tmp_path / "set"
    )
    assert 'unit = "V"' in (tmp_path / "set" / "dataset.toml").read_text()
    done = CliRunner().invoke(
        app, ["dataset", "show", str(tmp_path / "set"), "--out", str(tmp_path / "a.png")]
    )
    assert " V)" in done.output and "counts" not in done.output


# Those of practice and the insole are read in test_shared_data.py.
GOOD = [
    ROOT / "data" / "paper-like",
    *sorted((SHARED / "field" / "01-unclipped-rest").glob("*/")),
    SHARED / "field" / "13-untouched-scatter" / "counts",
]  # fmt: skip


@pytest.mark.parametrize(
    "folder", [path for path in GOOD if (path / "dataset.toml").exists()], ids=lambda p: p.name
)
def test_no_finding_on_good_data(folder: Path):
    assert [problem.code for problem in check_dataset(folder).warnings if problem.code] == []
