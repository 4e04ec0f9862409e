"""Readings that no load explains are empty wherever a dataset is used."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from skincal.dataset import Dataset, read_dataset, table_file, write_dataset
from skincal.dataset.corrections import (
    CONVERTER_RANGE,
    IMPOSSIBLE,
    clips_at_zero,
    converter_top,
    drop_outs,
    impossible_readings,
)
from skincal.dataset.word_checks import find_below_zero, load_from_images
from tests.dataset.changes import with_presses, with_sensor


def places(seed: int) -> np.ndarray:
    """Places (60, 3) [taxel] of the presses of a seed."""
    rng = np.random.default_rng(seed)
    rng.uniform(size=60)
    return np.column_stack([rng.uniform(0.0, 3.0, (60, 2)), np.zeros(60)])


def pressed(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Counts (60, 16) of round images that rest at 30 counts, and forces (60,)."""
    rng = np.random.default_rng(seed)
    force, at = rng.uniform(1.0, 4.5, 60), places(seed)[:, :2]
    rng.uniform(size=(60, 2))
    taxel = np.stack(np.meshgrid(np.arange(4), np.arange(4)), -1).reshape(-1, 2)
    distance2 = ((at[:, None] - taxel) ** 2).sum(axis=2)
    image = 30.0 * force[:, None] * np.exp(-distance2)
    return np.rint(image + 30.0 + rng.normal(0.0, 1.0, image.shape)), force


@pytest.mark.parametrize("seed", range(5))
def test_drop_outs_to_full_scale_and_nothing_else(seed: int) -> None:
    counts, force = pressed(seed)
    assert not impossible_readings(counts, force).any()
    dropped = np.random.default_rng(seed).random(counts.shape) < 0.015
    assert np.array_equal(impossible_readings(np.where(dropped, 4095.0, counts), force), dropped)


@pytest.mark.parametrize("seed", range(3))
def test_drop_outs_to_a_full_scale_that_loads_come_near(seed: int) -> None:
    """A converter that clips is none, in whatever order its taxels stand."""
    counts, force = pressed(seed)
    dropped = np.random.default_rng(seed).random(counts.shape) < 0.015
    full = np.where(dropped, counts.max() + 20, counts)
    assert not impossible_readings(full, force).any()
    assert np.array_equal(drop_outs(full, places(seed), force), dropped)
    clipped = np.minimum(counts, 100.0)[:, np.random.default_rng(seed).permutation(16)]
    for good in (counts, clipped):
        assert not drop_outs(good, places(seed), force).any()


@pytest.mark.parametrize("seed", range(3))
def test_drop_outs_are_no_words_below_zero(seed: int) -> None:
    counts, force = pressed(seed)
    dropped = np.random.default_rng(seed).random(counts.shape) < 0.02
    clipped = np.where(dropped, 255.0, np.maximum(counts - 30.0, 0.0))
    assert find_below_zero(clipped, image_load=load_from_images(places(seed), force, clipped)) is None


def test_one_taxel_images_with_unequal_gains_are_possible() -> None:
    rng = np.random.default_rng(0)
    force, counts = rng.uniform(1.0, 4.5, 60), rng.normal(30.0, 1.0, (60, 16))
    counts[np.arange(60), rng.integers(0, 16, 60)] += 200.0 * force
    assert not impossible_readings(counts, force).any()
    counts, force = pressed(0)
    counts[:, 5] = 30.0 + 20.0 * (counts[:, 5] - 30.0)
    assert not impossible_readings(counts, force).any()


@pytest.mark.parametrize("seed", range(5))
def test_readings_pile_up_where_a_converter_clips(seed: int) -> None:
    counts, _ = pressed(seed)
    assert converter_top(counts) is None
    assert converter_top(np.minimum(counts, 110.0)) == 110.0
    stuck = counts.copy()
    stuck[:, 3] = 300.0
    assert converter_top(stuck) is None
    assert clips_at_zero(np.maximum(counts - 30.0, 0.0).T)
    assert not clips_at_zero(counts.T - 30.0)
    assert not clips_at_zero(counts.T)


def test_a_converter_that_clips_is_known_when_read(session: Callable[..., Dataset], tmp_path: Path) -> None:
    counts, force = pressed(0)
    made = with_sensor(replace(session(60), frames=None), value_min=None, value_max=None)
    clipped = with_presses(made, counts=np.clip(counts - 30.0, 0.0, 80.0), force_n=force)
    write_dataset(clipped, tmp_path / "s")
    read = read_dataset(tmp_path / "s")
    assert (read.meta.sensor.value_min, read.meta.sensor.value_max) == (0.0, 80.0)
    assert {"sensor.value_min", "sensor.value_max"} <= set(read.meta.assumed)
    assert [w.code for w in read.warnings].count(CONVERTER_RANGE) == 1


@pytest.mark.parametrize("large", [False, True])
def test_a_dataset_has_none(
    session: Callable[..., Dataset], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, large: bool
) -> None:
    made = session(60, frames_per_press=5)
    counts, force = pressed(0)
    frames = made.frames
    assert frames is not None
    at = np.maximum(frames.press, 0)
    touched = (frames.press >= 0)[:, None]
    shown = np.where(touched, counts[at], 30.0)
    rng = np.random.default_rng(1)
    dropped, lost = rng.random(counts.shape) < 0.01, rng.random(shown.shape) < 0.01
    frames = replace(
        frames, counts=np.where(lost, 4095.0, shown), force_n=np.where(touched[:, 0], force[at], 0.0)
    )
    whole = with_sensor(replace(made, frames=frames), value_min=None, value_max=None)
    whole = with_presses(whole, counts=np.where(dropped, 4095.0, counts), force_n=force)
    write_dataset(whole, tmp_path / "s")
    if large:
        monkeypatch.setattr(table_file, "MOST_CELLS_HELD", 0)
    data = read_dataset(tmp_path / "s")
    assert np.array_equal(np.isnan(data.presses.counts), dropped)
    assert data.frames is not None and ("counts" in vars(data.frames)) != large
    assert np.array_equal(np.isnan(data.frames.counts), lost)
    told = next(w for w in data.warnings if w.code == IMPOSSIBLE)
    assert f"{dropped.sum()} readings" in told.got
