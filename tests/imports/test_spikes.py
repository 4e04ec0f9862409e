"""Taxels that drop out for single samples of a series."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from skincal.dataset import Dataset
from skincal.dataset.corrections import IMPOSSIBLE
from skincal.dataset.word_checks import find_falls
from skincal.imports.press_recording import find_spikes
from skincal.imports.recording import Cut, Span
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
