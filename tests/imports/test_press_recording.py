"""Samples of a series that are left out: spikes of taxels that drop out, contacts that slide while they are held."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from skincal.dataset import HOLD, Dataset, check_dataset
from skincal.dataset.corrections import IMPOSSIBLE
from skincal.dataset.placement import rests, sample_noise_m, slide_m
from skincal.dataset.word_checks import find_falls
from skincal.errors import InputError
from skincal.imports import Imported
from skincal.imports.press_recording import find_spikes
from skincal.imports.recording import Cut, Span
from tests.imports.devices import ONE_FILE, PLANE, contacts, whole_table
from tests.imports.foreign import SERIES, imported, mapping, recorded, series_table


def held(seed: int) -> tuple[np.ndarray, Cut]:
    """Counts (200, 4) of rest, a ramp and a hold, whose noise is less than the step of the converter or more."""
    rng = np.random.default_rng(seed)
    share = np.interp(np.arange(200), [60, 80, 150, 160], [0, 1, 1, 0])
    noise = np.array([0.2, 1.0, 1.0, 4.0])
    counts = np.rint(20 + share[:, None] * [0, 40, 120, 150] + noise * rng.standard_normal((200, 4)))
    return counts, Cut((Span(0, 60, 80, 150, 160),), ())


@pytest.mark.parametrize("seed", range(20))
def test_noise_has_no_spikes(seed: int) -> None:
    counts, cut = held(seed)
    assert not find_spikes(counts, cut).any()


@pytest.mark.parametrize("value", [0.0, 255.0, np.nan])
def test_spikes_are_single_samples_far_off(value: float) -> None:
    counts, cut = held(0)
    assert not find_spikes(counts, cut).any()
    at = np.array([[10, 0], [100, 1], [101, 2], [130, 3], [70, 1], [30, 2], [32, 2]])
    dropped = counts.copy()
    dropped[tuple(at.T)] = value
    dropped[90:95, 0] = 0.0
    found = np.argwhere(find_spikes(dropped, cut))
    # A value that stays is none.
    expected = [] if np.isnan(value) else sorted(at.tolist())
    assert sorted(found.tolist()) == expected


def test_many_spikes_are_the_signal() -> None:
    counts, cut = held(1)
    counts[::6] = 0.0
    assert not find_spikes(counts, cut).any()


@pytest.mark.parametrize("value", [0, 255])
def test_an_import_leaves_spikes_out(session: Callable[..., Dataset], tmp_path: Path, value: int) -> None:
    recording = recorded(session(8, frames_per_press=0))
    table = series_table(recording)
    taxels = [str(name) for name in table if str(name).startswith("tax_")]
    clean, bad = table[taxels].to_numpy(), np.random.default_rng(2).random((len(table), len(taxels))) < 0.01
    bad[500] = True
    table[taxels] = np.where(bad, value, clean)
    table.to_csv(tmp_path / "a.csv", index=False)
    back, done = imported(tmp_path, mapping(SERIES), [tmp_path / "a.csv"])
    assert [one.code for one in done.warnings if one.code] == [IMPOSSIBLE]
    np.testing.assert_allclose(back.presses.counts, recording.image, atol=2.0, rtol=0.01)


@pytest.mark.parametrize("rules", [{}, {"by": "plateaus", "slope_n_per_s": 1.0}])
@pytest.mark.parametrize("values", [[-1.0], [0.0], [9999.0], [-12.0, 12.0, 20.0]])
def test_an_import_leaves_spikes_of_the_force_out(
    session: Callable[..., Dataset], tmp_path: Path, values: list[float], rules: dict[str, Any]
) -> None:
    recording = recorded(session(8, frames_per_press=0))
    table, rng = series_table(recording), np.random.default_rng(4)
    at = np.arange(5, len(table) - 30, 30)  # several in each press, never two in succession
    at += rng.integers(0, 20, len(at))
    table.loc[at, "F"] = rng.choice(values, len(at))
    table.to_csv(tmp_path / "a.csv", index=False)
    back, done = imported(tmp_path, mapping(SERIES, series=rules), [tmp_path / "a.csv"])
    (found,) = [one for one in done.warnings if one.code]
    assert found.code == IMPOSSIBLE and "force" in str(found)
    assert len(back.presses) == 8
    np.testing.assert_allclose(back.presses.force_n, recording.level_n, rtol=0.01)
    np.testing.assert_allclose(back.presses.counts, recording.image, atol=2.0, rtol=0.01)
    # A jump to 0 shows in contact only.
    (left_out,) = [item.count for item in done.dropped if item.what == "sample"]
    assert left_out == (len(at) if 0.0 not in values else pytest.approx(len(at) * 0.6, rel=0.4))


def test_single_drop_outs_are_no_words_that_overflow() -> None:
    press = np.repeat(np.arange(10), 20)
    counts = np.rint(100.0 + np.random.default_rng(3).normal(0, 1, (200, 3)))
    counts[press < 5] -= 90.0
    force = np.full(200, 2.0)
    assert find_falls(counts, press, force) is None
    dropped = counts.copy()
    dropped[5::20, 1] = 255.0
    dropped[125:127, 2] = 255.0
    assert find_falls(dropped, press, force) is None


FOUND = contacts(slide_m=0.006)
TIME = np.arange(0, FOUND.end_s, 0.02)


def bring(
    folder: Path, *, noise_m: float = 1e-4, slide: bool = True, **changes: Any
) -> tuple[Dataset, Imported]:
    found = FOUND if slide else contacts()
    table = whole_table(found, TIME)
    table[["px", "py"]] += np.random.default_rng(2).normal(0, 1e3 * noise_m, (len(TIME), 2))
    table.to_csv(folder / "a.csv", index=False)
    return imported(folder, mapping(PLANE, ONE_FILE, **changes), [folder / "a.csv"])


def findings(done: Any) -> list[Any]:
    return [problem for problem in done.warnings if problem.code == "slides_in_hold"]


def test_hold_is_cut_to_where_the_contact_rests(tmp_path: Path):
    back, done = bring(tmp_path)
    (found,) = findings(done)
    assert found.details["presses"] == [0, 2, 4, 6, 8, 10]
    assert "press 0 (5." in found.got
    # Half a millimetre is what the positions are worth; the mean of the slide lies 3 mm off.
    np.testing.assert_allclose(back.presses.position_m[:, :2], FOUND.place_m, atol=5e-4)
    assert not findings(check_dataset(tmp_path / "out"))


@pytest.mark.parametrize(("slide_m", "turns"), [(5e-3, 0.0), (8e-3, 0.0), (1e-3, 1.0)])
def test_contact_that_slides_all_the_time(tmp_path: Path, slide_m: float, turns: float):
    """The part of a hold that is kept also rests by the check of the dataset, which smooths it less than the whole."""
    found = contacts(20, 3)
    table = whole_table(found, TIME)
    now = np.minimum(np.searchsorted(found.start_s + found.lasts_s, TIME), 19)
    share = np.clip((TIME - found.start_s[now]) / found.lasts_s[now], 0, 1)
    path = np.exp(2j * np.pi * turns * share) if turns else share + 0j
    table["px"] += 1e3 * slide_m * path.real
    table["py"] += 1e3 * slide_m * path.imag
    table.to_csv(tmp_path / "a.csv", index=False)
    assert len(findings(imported(tmp_path, mapping(PLANE, ONE_FILE), [tmp_path / "a.csv"])[1])) == 1
    assert not findings(check_dataset(tmp_path / "out"))


def test_sliding_is_refused_or_kept_where_asked(tmp_path: Path):
    with pytest.raises(InputError, match="6 of 12 that slide: press 0"):
        bring(tmp_path, series={"slides": "refuse"})
    back, done = bring(tmp_path, series={"slides": "keep"})
    assert findings(done)
    away = np.abs(back.presses.position_m[:, 0] - FOUND.place_m[:, 0])
    assert (away[::2] > 1.5e-3).all() and (away[1::2] < 1e-4).all()
    # The dataset says it as well, with the presses.
    (found,) = [p for p in findings(check_dataset(tmp_path / "out")) if "sigma_m" in p.expected]
    assert found.details["presses"] == [0, 2, 4, 6, 8, 10]


@pytest.mark.parametrize("noise_m", [0.0, 1e-4, 1e-3])
def test_noise_is_no_slide(tmp_path: Path, noise_m: float):
    back, done = bring(tmp_path, noise_m=noise_m, slide=False)
    assert not findings(done)
    assert len(back.presses) == 12


def test_contact_that_never_rests_is_left_out(tmp_path: Path):
    changes = {"series": {"min_hold_s": 0.6}, "position": {"sigma_m": 1e-4, "slack_m": 1e-3}}
    back, done = bring(tmp_path, noise_m=0.0, **changes)
    assert len(back.presses) < 12
    assert any("the contact rests for less than 0.6 s" in str(item) for item in done.dropped)
    assert back.frames is not None and (back.frames.phase == HOLD).any()


@pytest.mark.parametrize("samples", [10, 30, 100, 400])
def test_false_alarms_of_noise(samples: int):
    rng = np.random.default_rng(samples)
    holds = [rng.normal(0, 1e-3, (samples, 3)) for _ in range(300)]
    noise_m = sample_noise_m(holds)
    slides = [slide_m(hold, noise_m) for hold in holds]
    assert np.mean(np.array(slides) > 1e-4) < 0.01


def test_where_a_contact_rests():
    path = np.concatenate([np.zeros(20), np.linspace(0, 0.005, 30), np.full(40, 0.005)])
    position = np.column_stack([path, np.zeros((90, 2))])
    start, stop = rests(position, 1e-4, 0.0)
    assert 45 <= start <= 51 and stop == 90
    assert slide_m(position, 0.0) == pytest.approx(0.005, rel=0.02)
    assert np.isnan(slide_m(np.full((20, 3), np.nan), 0.0))
