"""Bins, splits and the noise floor."""

from __future__ import annotations

import numpy as np
import pytest
from gap.gap_sessions import READOUT, full, static
from hypothesis import given
from hypothesis import strategies as st

from skincal.effects.samples import HOLD, IDLE, LOAD, UNLOAD
from skincal.fit.observe import Readout
from skincal.gap.noise import (
    Whitening,
    assumed_floor,
    frame_scatter,
    noise_floor,
    noisy_taxels,
    plateau_scatter,
    pooled,
    repeat_scatter,
)
from skincal.gap.session import Binning, bins_of
from skincal.gap.split import FINAL, SELECTION, TRAIN, split_presses

NOTHING = (np.zeros(0), np.zeros(0))
UNKNOWN, REST = np.full(16, np.nan), np.full(16, 0.4)


@given(
    st.lists(
        st.tuples(st.integers(1, 60), st.sampled_from([IDLE, LOAD, HOLD, UNLOAD])), min_size=1, max_size=8
    )
)
def test_bins_keep_to_presses_phases_and_their_bound(stretches: list[tuple[int, int]]):
    row = np.repeat(np.arange(len(stretches)), [n for n, _ in stretches])
    phase = np.repeat([p for _, p in stretches], [n for n, _ in stretches])
    bins = bins_of(row, phase, Binning())
    assert (np.diff(bins) >= 0).all() and (np.diff(bins) <= 1).all() and bins[0] == 0
    for k, (length, kind) in enumerate(stretches):
        own = np.unique(bins[row == k])
        assert 1 <= len(own) <= Binning().of_phase(kind)
        assert not np.isin(bins[row != k], own).any()
        if length <= Binning().of_phase(kind):
            assert len(own) == length


def test_hold_bins_grow():
    bins = bins_of(np.zeros(100, dtype=int), np.full(100, HOLD), Binning())
    sizes = np.bincount(bins)
    assert len(sizes) == 6 and sizes[-1] > 3 * sizes[0]


def test_binned_means_are_means():
    session = full(6)
    assert session.has_frames and (session.frames >= 1).all()
    values = np.random.default_rng(0).normal(size=(len(session.samples), 3))
    assert np.array_equal(session.means(values), values)
    holds = static(4)
    seen = holds.observation == 2
    values = np.random.default_rng(0).normal(size=(len(holds.samples), 3))
    assert np.allclose(holds.means(values)[2], values[seen].mean(axis=0))


def test_memory_does_not_reach_over_presses_without_frames():
    framed, holds = full(4), static(4, clock=True)
    assert framed.remembered is framed.samples
    assert static(4).remembered.time_s is None
    before, after = holds.samples.time_s, holds.remembered.time_s
    assert before is not None and after is not None
    pause = np.diff(after) > 1e5
    assert pause.sum() == holds.presses - 1
    force = holds.samples.contacts.force_n
    # Nothing is pressed before the pause nor after it, so loading is as quick as it was.
    assert not force[:-1][pause].any() and not force[1:][pause].any()
    assert (np.diff(np.cumsum(pause)[np.flatnonzero(np.diff(holds.row) > 0)]) == 1).all()
    assert np.allclose(np.diff(after)[~pause], np.diff(before)[~pause])
    # Drifts go on by the clock of the session.
    assert np.allclose(holds.remembered.elapsed_s, holds.samples.elapsed_s)
    late = np.arange(len(after)) > len(after) // 2
    assert np.allclose(holds.remembered[late].elapsed_s, holds.samples[late].elapsed_s)


@pytest.mark.parametrize("presses", [3, 7, 60, 90])
def test_split_has_three_parts_and_leaves_sites_out(presses: int):
    site = np.random.default_rng(1).integers(0, max(2, presses // 2), presses)
    split = split_presses(site, np.random.default_rng(7))
    again = split_presses(site, np.random.default_rng(7))
    assert np.array_equal(split.part, again.part)
    counts = np.bincount(split.part, minlength=3)
    assert len(counts) == 3 and (counts > 0).all()
    if presses >= 60:
        assert counts[TRAIN] >= 0.35 * presses
        assert counts[SELECTION] >= 0.15 * presses and counts[FINAL] >= 0.15 * presses
        alone = [s for s in np.unique(site) if set(split.part[site == s]) == {FINAL}]
        assert len(alone) >= round(0.1 * len(np.unique(site)))


def test_split_keeps_the_anchor():
    site = np.concatenate([np.arange(1, 41), np.zeros(20, dtype=int)])
    parts = [split_presses(site, np.random.default_rng(s)).part[site == 0] for s in range(5)]
    assert all(len(set(part.tolist())) > 1 for part in parts)


def test_too_few_presses_are_not_split():
    with pytest.raises(ValueError, match="three presses"):
        split_presses(np.arange(2), np.random.default_rng(0))


def held(sigma: float, seed: int = 0, glitch: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Frames of 40 holds of 25 frames, rounded and clipped, on a slope as creep has."""
    rng = np.random.default_rng(seed)
    level = rng.uniform(0, 80, (40, 1, 5)) * (rng.uniform(size=(40, 1, 5)) < 0.6)
    frames = level * np.linspace(1.0, 1.05, 25)[None, :, None] + rng.normal(0, sigma, (40, 25, 5))
    counts = np.clip(np.round(frames), 0, 255).reshape(-1, 5)
    if glitch:
        counts[100:125] = rng.uniform(0, 200, (25, 5))
    return counts, np.repeat(np.arange(40), 25)


@pytest.mark.parametrize("sigma", [0.6, 1.0, 3.0])
@pytest.mark.parametrize("glitch", [False, True])
def test_noise_of_frames_is_found(sigma: float, glitch: bool):
    counts, group = held(sigma, glitch=glitch)
    scatter = frame_scatter(counts, group, READOUT)
    floor = noise_floor(scatter, NOTHING, UNKNOWN, np.nan, 25, READOUT, np.random.default_rng(0))
    assert floor.frame_from == "hold frames"
    assert floor.frame_counts == pytest.approx(sigma, rel=0.12)
    low, high = floor.frame_interval
    assert 0.9 * low < sigma < 1.1 * high
    assert floor.mean_counts == pytest.approx(np.hypot(sigma, 1 / np.sqrt(12)) / 5, rel=0.12)


def test_a_stuck_taxel_does_not_lower_the_noise_of_the_others():
    counts, group = held(1.0)
    counts[:, 2] = 100.0
    squares, freedom = frame_scatter(counts, group, READOUT)
    others, _ = frame_scatter(np.delete(counts, 2, axis=1), group, READOUT)
    assert np.array_equal(squares, others) and freedom.min() > 0


def test_noisy_taxels_are_told_from_usual_ones():
    rng = np.random.default_rng(4)
    level, sigma = rng.uniform(20, 80, (40, 1, 6)), np.array([1.0, 1.0, 4.0, 1.0, 1.0, 0.2])
    counts = np.round(level + sigma * rng.normal(size=(40, 25, 6))).reshape(-1, 6)
    group = np.repeat(np.arange(40), 25)
    found = noisy_taxels(counts, group, READOUT)
    # One that scatters less may be stuck: it keeps the usual noise.
    assert np.flatnonzero(np.isfinite(found)).tolist() == [2]
    assert found[2] == pytest.approx(4.0, rel=0.12)
    # Where rounding makes most of the scatter, taxels scatter as their levels lie.
    quiet = np.round(level + 0.1 * rng.normal(size=(40, 25, 6))).reshape(-1, 6)
    assert np.isnan(noisy_taxels(quiet, group, READOUT)).all()
    # Of too few frames nothing is said, and of taxels that are all alike neither.
    assert np.isnan(noisy_taxels(counts[:50], group[:50], READOUT)).all()
    assert np.isnan(noisy_taxels(*held(1.0), READOUT)).all()


def test_one_long_hold_that_went_wrong_makes_no_taxel_noisy():
    """It may have most of the frames in which a taxel of the border is lit at all."""
    rng = np.random.default_rng(4)
    sizes = np.array([150, *[25] * 30])
    group = np.repeat(np.arange(len(sizes)), sizes)
    counts = np.round(50.0 + rng.normal(size=(sizes.sum(), 6)))
    counts[(group > 4), 1] = 0.0
    assert np.isnan(noisy_taxels(counts, group, READOUT)).all()
    counts[100:150, 1] += 60.0
    assert np.isnan(noisy_taxels(counts, group, READOUT)).all()
    # One whose other holds scatter as well is noisy.
    counts[(group > 0) & (group <= 4), 1] = np.round(50.0 + 5.0 * rng.normal(size=100))
    assert np.flatnonzero(np.isfinite(noisy_taxels(counts, group, READOUT))).tolist() == [1]


def test_a_floor_with_noisy_taxels_keeps_the_usual_noise():
    counts, group = held(1.0)
    floor = noise_floor(
        frame_scatter(counts, group, READOUT), NOTHING, UNKNOWN, np.nan, 25, READOUT, np.random.default_rng(0)
    )
    assert floor.sigma_counts == floor.frame_counts
    some = floor.by_taxel(np.array([np.nan, 4.0]))
    assert some.frame_counts == floor.frame_counts
    assert np.asarray(some.sigma_counts).tolist() == [floor.frame_counts, 4.0]
    assert floor.by_taxel(np.array([np.nan, 0.01])) is floor


@pytest.mark.parametrize("memory", [0.0, 2.0])
def test_noise_of_plateaus_is_what_their_curve_leaves(memory: float):
    rng = np.random.default_rng(6)
    force = np.concatenate([np.linspace(1.0, 12.0, 12), np.linspace(11.0, 1.0, 11)])
    down = np.arange(23) > 11
    curve = 5.0 * force - 0.02 * force**2 + np.where(down, memory * force * (12 - force) / 36, 0.0)
    gain = rng.uniform(0.5, 1.5, 30)
    means = curve[:, None] * gain + 0.2 * rng.normal(size=(23, 30))
    means[8:, 4] += 20.0
    assert plateau_scatter(means, force) == pytest.approx(0.2, rel=0.35)
    assert np.isnan(plateau_scatter(means[:5], force[:5]))


@pytest.mark.parametrize("fade_s", [0.15, 0.5, 3.0])
def test_what_fades_in_a_hold_is_no_noise(fade_s: float):
    rng = np.random.default_rng(2)
    level = rng.uniform(20, 80, (40, 1, 5))
    fading = 1 + 0.15 * np.exp(-0.04 * np.arange(25) / fade_s)[None, :, None]
    counts = np.round(level * fading + rng.normal(0, 1.0, (40, 25, 5))).reshape(-1, 5)
    scatter = frame_scatter(counts, np.repeat(np.arange(40), 25), READOUT)
    floor = noise_floor(scatter, NOTHING, UNKNOWN, np.nan, 25, READOUT, np.random.default_rng(0))
    assert floor.frame_counts == pytest.approx(1.0, rel=0.06)


def test_straight_holds_keep_their_degrees_of_freedom_and_a_glitch_takes_none():
    rng = np.random.default_rng(3)
    lines = (
        rng.uniform(20, 80, (30, 1, 5)) + rng.uniform(-0.2, 0.2, (30, 1, 5)) * np.arange(25)[None, :, None]
    )
    counts = lines + rng.normal(0, 1.0, (30, 25, 5))
    group = np.repeat(np.arange(30), 25)
    squares, freedom = frame_scatter(counts.reshape(-1, 5), group, READOUT)
    assert (freedom == 23 * 5).all()
    assert np.sqrt(squares.sum() / freedom.sum()) == pytest.approx(1.0, rel=0.03)
    # One hold in which the contact slips: the others stay straight.
    counts[7, 12:] += 15.0
    bent, same = frame_scatter(counts.reshape(-1, 5), group, READOUT)
    assert (same == freedom).all() and np.delete(bent, 7) == pytest.approx(np.delete(squares, 7))
    # All of them bend: the noise is still that of a frame.
    counts += 10 * np.exp(-np.arange(25) / 4)[None, :, None]
    curved, fewer = frame_scatter(np.delete(counts, 7, axis=0).reshape(-1, 5), group[:-25], READOUT)
    assert (fewer < 23 * 5).all()
    assert np.sqrt(curved.sum() / fewer.sum()) == pytest.approx(1.0, rel=0.05)


def test_holds_without_noise_have_none():
    group = np.repeat(np.arange(10), 8)
    for level in (0.0, 30.0):
        counts = np.full((80, 5), level)
        squares, freedom = frame_scatter(counts, group, Readout(None, None, integer=False))
        assert (freedom == 6 * 5).all() and squares.max() < 1e-20
    # A flip of one count in some of the holds is noise like any other.
    counts[[3, 20, 21, 60], 2] += 1.0
    squares, freedom = frame_scatter(counts, group, READOUT)
    assert (squares > 0.3).sum() == 3


def test_noise_of_repeats_leaves_place_and_force_out():
    rng = np.random.default_rng(0)
    slopes = rng.normal(0, 10, (60, 16, 3))
    slopes[30:] = slopes[:30]
    truth = rng.uniform(10, 60, (30, 16))
    means = np.vstack([truth, truth]) + np.einsum("pjd,pd->pj", slopes, rng.normal(size=(60, 3)))
    means += rng.normal(0, 0.3, means.shape)
    scatter = repeat_scatter(means, np.arange(30), np.arange(30, 60), slopes, np.ones((60, 16), dtype=bool))
    sigma, (low, high) = pooled(*scatter, rng)
    assert sigma == pytest.approx(0.3, rel=0.15)
    assert low < 0.3 < high


def test_repeats_are_a_bound_from_above():
    far, near = [np.full(30, s**2 * 10.0) for s in (2.0, 0.1)], np.full(30, 10.0)
    counts, group = held(1.0)
    scatter = frame_scatter(counts, group, READOUT)
    for squares in far:
        floor = noise_floor(scatter, (squares, near), REST, np.nan, 25, READOUT, np.random.default_rng(0))
        assert floor.mean_from == "hold frames" and floor.mean_counts == pytest.approx(0.208, rel=0.1)
        assert floor.repeat_counts == pytest.approx(np.sqrt(squares[0] / 10), rel=0.1)
    still = noise_floor(
        NOTHING, (np.full(30, 0.1), near), REST, np.nan, 1.0, READOUT, np.random.default_rng(0)
    )
    assert still.mean_from == "repeats" and still.mean_counts == pytest.approx(0.1, rel=0.1)
    # Repeats without any noise are copies: they do not say that there is none.
    copies = noise_floor(NOTHING, (np.zeros(30), near), REST, np.nan, 1.0, READOUT, np.random.default_rng(0))
    assert copies.mean_from != "repeats" and copies.mean_counts > 0.1


def test_floor_from_clipped_rest_and_from_nothing():
    rest = np.random.default_rng(1).normal(0.4, 0.05, 16)
    clipped = noise_floor(NOTHING, NOTHING, rest, np.nan, 1.0, READOUT, np.random.default_rng(0))
    assert clipped.frame_from == "clipped rest" and clipped.frame_counts == pytest.approx(1.0, abs=0.1)
    low, high = clipped.frame_interval
    assert 0.8 < low < clipped.frame_counts < high < 1.2
    open_ended = Readout(None, None, integer=False)
    nothing = noise_floor(NOTHING, NOTHING, UNKNOWN, np.nan, 1.0, open_ended, np.random.default_rng(0))
    assert nothing.frame_from == "assumed" and nothing.rounding_counts == 0 and not nothing.measured
    # Repeats are something, whether they differ by more or less than what would be assumed.
    for size in (0.5, 2.0):
        squares, freedom = np.random.default_rng(2).chisquare(4, 40) * size**2, np.full(40, 4.0)
        some = noise_floor(
            NOTHING, (squares, freedom), UNKNOWN, np.nan, 1.0, open_ended, np.random.default_rng(0)
        )
        assert some.mean_from == "repeats" and some.measured
        assert some.mean_counts == pytest.approx(size, rel=0.1)


def test_whitening_is_that_of_simulated_counts():
    rng = np.random.default_rng(0)
    values = np.array([[0.0, 0.7, 20.0, 254.8]])
    weight = Whitening(1.0, READOUT).weight(values, np.array([4.0]))[0]
    step = 0.25
    noise = rng.normal(size=(200000, 1))
    low, high = (np.clip(np.round(values + s + noise), 0, 255) for s in (-step, step))
    slope = (high.mean(axis=0) - low.mean(axis=0)) / (2 * step)
    spread = np.clip(np.round(values + noise), 0, 255).std(axis=0) / 2
    assert weight == pytest.approx(slope / spread, rel=0.08)


def test_assumed_floor():
    floor = assumed_floor(READOUT, 1.0, 25)
    assert floor.frame_from == "assumed"
    assert floor.mean_counts == pytest.approx(np.hypot(1, 12**-0.5) / 5)
