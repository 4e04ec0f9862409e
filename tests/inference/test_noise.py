"""Noise, rounding and clipping as the engine takes them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from skincal.inference.noise import Noise, noise_of, sigma_before_rounding, step_of


def frames(
    sigma: float, step: float, rest: float, grows: float, low: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(1)
    level = np.repeat(rng.uniform(0, 120, (60, 16)) * (rng.uniform(size=(60, 16)) < 0.5), 25, axis=0)
    noisy = level + rest + np.hypot(sigma, grows * level) * rng.standard_normal(level.shape)
    return np.clip(step * np.rint(noisy / step), low, 255 + rest), np.repeat(np.arange(60), 25)


@pytest.mark.parametrize("step", [1.0, 2.0, 4.0])
@pytest.mark.parametrize("rest", [0.0, 25.0])
def test_the_noise_before_rounding_is_found(step: float, rest: float):
    counts, hold = frames(1.0, step, rest, 0.0)
    found = noise_of(
        counts, hold, np.full(len(hold), -1), np.zeros(len(hold)), 0.0, 255.0 + rest, integer=True
    )
    assert found.step == step and found.grows == 0.0
    assert found.frame == pytest.approx(1.0, abs=0.1 * step)


def test_noise_that_grows_is_reported_from_noise_that_does_not():
    counts, hold = frames(1.0, 1.0, 40.0, 0.03)
    found = noise_of(counts, hold, np.full(len(hold), -1), np.zeros(len(hold)), 0.0, 295.0, integer=True)
    assert found.grows == pytest.approx(0.03, rel=0.2)
    assert found.frame == pytest.approx(1.0, rel=0.2)


def test_noise_at_rest_does_not_grow_with_the_level_there():
    counts, hold = frames(1.0, 2.0, 40.0, 0.03)
    idle = 2 * np.rint((40.7 + np.random.default_rng(5).standard_normal((3000, 16))) / 2)
    counts = np.concatenate([counts, idle])
    rest = np.concatenate([np.full(len(hold), -1), np.zeros(3000, np.int64)])
    hold, force = np.concatenate([hold, np.full(3000, -1)]), np.zeros(len(counts))
    found = noise_of(counts, hold, rest, force, 0.0, 295.0, integer=True)
    assert found.frame == pytest.approx(1.0, rel=0.05) and found.grows == pytest.approx(0.03, rel=0.2)


def test_a_clipped_level_reads_what_its_frames_do_on_average():
    rng = np.random.default_rng(2)
    noise = Noise(np.ones(3), 0.0, 1.0, 0.0, 255.0)
    level = np.array([0.0, 1.5, 30.0])
    counts = np.clip(np.rint(level + rng.standard_normal((200_000, 3))), 0, 255)
    mean, slope = noise.written(level[None])
    assert mean[0] == pytest.approx(counts.mean(axis=0), abs=0.01)
    assert 0.4 < slope[0, 0] < 0.6 and slope[0, 2] == pytest.approx(1.0, abs=1e-6)
    assert noise.variance(level[None], np.ones(1))[0] == pytest.approx(counts.var(axis=0), rel=0.03)


@pytest.mark.parametrize("spread", [0.1, 1.0, 3.0])
@pytest.mark.parametrize("level", [16.0, 19.0, 61.0])
def test_reading_of_an_uncertain_level_on_a_staircase(level: float, spread: float):
    rng = np.random.default_rng(3)
    noise = Noise(np.ones(1), 0.02, 8.0, 0.0, 255.0, rest=16.0)
    levels = level + spread * rng.standard_normal((40_000, 1))
    sd = np.hypot(1.0, 0.02 * np.maximum(levels - 16.0, 0.0))
    counts = np.clip(8 * np.rint((levels + sd * rng.standard_normal((40_000, 12))) / 8), 0, 255)
    mean, slope, each, shared = (float(x[0]) for x in noise.moments(np.array([level]), np.array([spread])))
    assert mean == pytest.approx(counts.mean(), abs=0.15)
    assert each == pytest.approx(counts.var(axis=1, ddof=1).mean(), rel=0.05, abs=0.4)
    of_levels = counts.mean(axis=1)
    along = np.cov(levels[:, 0], of_levels)[0, 1] / levels.var()
    assert slope == pytest.approx(along, abs=0.1 + 0.05 / spread)
    left = of_levels.var() - counts.var(axis=1, ddof=1).mean() / 12 - along**2 * levels.var()
    assert shared == pytest.approx(left, abs=0.6)


@pytest.mark.parametrize("sigma", [0.8, 1.2])
def test_noise_at_rest_explains_the_frames(sigma: float):
    counts, hold = frames(sigma, 4.0, 0.0, 0.0, low=-np.inf)
    idle = 4 * np.rint(sigma * np.random.default_rng(6).standard_normal((1500, 16)) / 4)
    both = np.concatenate([counts, idle]) + 25.0
    rest = np.append(np.full(len(hold), -1), np.zeros(len(idle), dtype=int))
    found = noise_of(
        both, np.append(hold, np.full(len(idle), -1)), rest, np.zeros(len(both)), 0.0, 280.0, integer=True
    )
    # The variance of a frame at rest follows the noise several times as fast as the noise itself.
    assert found.frame == pytest.approx(sigma, rel=0.02)


def test_steps_need_not_begin_at_zero():
    counts, hold = frames(1.0, 4.0, 0.0, 0.0, low=-np.inf)
    found = noise_of(
        counts + 25.0, hold, np.full(len(hold), -1), np.zeros(len(hold)), 0.0, 280.0, integer=True
    )
    assert found.step == 4.0 and found.origin % 4.0 == 1.0
    mean, _ = replace(found, rest=25.0).written(np.array([25.0, 26.0]))
    assert mean[0] == pytest.approx(25.0, abs=1e-3) and mean[1] < 25.8


@pytest.mark.parametrize("rest", [20.0, 23.0])
def test_noise_of_levels_anywhere_on_a_staircase(rest: float):
    # At the edge of a step frames at rest change all the time, in its middle never.
    counts, hold = frames(1.0, 8.0, rest, 0.0)
    found = noise_of(
        counts, hold, np.full(len(hold), -1), np.zeros(len(hold)), 0.0, 255.0 + rest, integer=True
    )
    assert found.frame == pytest.approx(1.0, abs=0.35)


def test_level_of_a_mean_is_limited_by_its_step():
    noise = Noise(np.ones(1), 0.0, 8.0, 0.0, 255.0, rest=20.0)
    edge, within = noise.level_of(float(noise.written(np.array([20.5]))[0][0]), 2000.0)
    assert edge == pytest.approx(20.5, abs=0.2) and within < 0.2
    assert noise.level_of(24.0, 2000.0)[1] > 0.3


def test_steps_and_their_share_of_the_scatter():
    assert step_of(np.array([[8.0, 16.0, 40.0]])) == 8.0
    assert step_of(np.random.default_rng(0).normal(size=(50, 2))) == 0.0
    assert sigma_before_rounding(1.0 + 1 / 12, 1.0) == pytest.approx(1.0, rel=1e-3)


@pytest.mark.parametrize("seed", range(4))
def test_steps_of_eight_times_the_noise(seed: int):
    """Second differences said up to 1.7 here, where few presses lie near the edge of a step."""
    rng = np.random.default_rng(seed)
    level = rng.uniform(0, 120, (90, 16)) * (rng.uniform(size=(90, 16)) < 0.15)
    # The level gives way by a few counts in the hold.
    creeping = level * (1 + 0.02 * np.linspace(0, 1, 25)[:, None, None] ** 0.5)
    held = creeping.swapaxes(0, 1).reshape(-1, 16) + 21.0
    noisy = np.concatenate([held, np.full((2500, 16), 21.0)])
    counts = 8 * np.rint((noisy + rng.standard_normal(noisy.shape)) / 8)
    hold = np.append(np.repeat(np.arange(90), 25), np.full(2500, -1))
    rest = np.where(hold < 0, 0, -1)
    found = noise_of(counts, hold, rest, np.zeros(len(hold)), 0.0, 276.0, integer=True)
    assert found.frame == pytest.approx(1.0, abs=0.2)
    assert found.grows == 0.0 and 0.01 < found.within < 0.15
    assert found.sigma == pytest.approx(np.full(16, found.frame))


@pytest.mark.parametrize("integer", [True, False])
def test_noise_that_a_bound_clips_is_not_underrated(integer: bool):
    """Most frames rest on the bound, where they scatter by six tenths of the noise."""
    rng = np.random.default_rng(4)
    level = np.repeat(rng.uniform(0, 120, (60, 16)) * (rng.uniform(size=(60, 16)) < 0.2), 25, axis=0)
    noisy = level + 3.0 * rng.standard_normal(level.shape)
    counts = np.clip(np.rint(noisy) if integer else noisy, 0.0, 255.0)
    hold = np.repeat(np.arange(60), 25)
    found = noise_of(counts, hold, np.full(len(hold), -1), np.zeros(len(hold)), 0.0, 255.0, integer=integer)
    assert found.frame == pytest.approx(3.0, rel=0.05) and found.grows == 0.0


def test_frames_at_rest_tell_the_noise_where_a_bound_clips_them():
    """Few taxels are pressed: alone they miss the noise by some 3 %, and what is said of the error holds."""
    off, said = [], []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        level = np.repeat(rng.uniform(8, 40, (60, 16)) * (rng.uniform(size=(60, 16)) < 0.04), 25, axis=0)
        noisy = np.concatenate([level, np.zeros((3000, 16))]) + rng.standard_normal((4500, 16))
        counts = np.clip(np.rint(noisy), 0.0, 255.0)
        hold = np.append(np.repeat(np.arange(60), 25), np.full(3000, -1))
        rest = np.where(hold < 0, 0, -1)
        found = noise_of(counts, hold, rest, np.zeros(len(hold)), 0.0, 255.0, integer=True)
        off.append(found.frame - 1.0)
        said.append(found.within)
    spread = float(np.sqrt(np.mean(np.square(off))))
    assert spread < 0.02
    assert 0.4 * spread < float(np.mean(said)) < 2.5 * spread


def test_a_line_through_a_staircase_bends_where_it_is_clipped():
    stairs = Noise(np.full(3, 0.8), 0.0, 8.0, 0.0, 255.0, rest=30.0)
    line = replace(stairs, stairs=stairs)
    level, near = np.linspace(25.0, 120.0, 400), np.linspace(-15.0, 15.0, 50)
    mean, slope, each, shared = line.moments(level, np.full_like(level, 0.2))
    assert mean == pytest.approx(stairs.moments(level, np.full_like(level, 0.2))[0])
    assert slope == pytest.approx(1.0, abs=1e-6)
    # A level anywhere within a step is off by its noise, and by the step's own width.
    assert each + shared == pytest.approx(0.8**2 + 8.0**2 / 12)
    assert (np.diff(line.moments(near)[1]) >= 0).all() and line.moments(near)[1][0] < 0.01
