from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skincal.fitting.observe import Readout, clipped_share, expected_counts, noise_from_rest, observe

CONVERTER = Readout(0, 255, True)


@pytest.mark.parametrize("sigma", [0.4, 1.0, 3.0])
@pytest.mark.parametrize("integer", [True, False])
def test_expected_counts_are_the_mean_of_many_frames(sigma: float, integer: bool) -> None:
    rng = np.random.default_rng(0)
    values = np.array([-2.0, 0.0, 0.3, 1.0, 5.0, 120.0, 254.0, 256.0])
    frames = values + sigma * rng.standard_normal((200_000, len(values)))
    read = np.clip(np.rint(frames) if integer else frames, 0, 255).mean(axis=0)
    assert expected_counts(values, sigma, Readout(0, 255, integer)) == pytest.approx(read, abs=0.03)


@given(st.floats(0.02, 6.0), st.floats(-0.5, 0.5))
@settings(max_examples=20)
def test_interpolation_of_many_values_is_that_of_each(sigma: float, shift: float) -> None:
    values = np.linspace(-12 * sigma - 2, 300.0, 30_000) + shift
    some = values[:: len(values) // 60]
    many = expected_counts(values, sigma, CONVERTER)[:: len(values) // 60]
    alone = np.array([float(expected_counts(one, sigma, CONVERTER)) for one in some])
    assert np.abs(many - alone).max() < 5e-6 * (1 + sigma)
    # A press's worth reads what it does within a session.
    part = values[1000:1300]
    assert np.array_equal(
        expected_counts(part, sigma, CONVERTER), expected_counts(values, sigma, CONVERTER)[1000:1300]
    )


@given(st.floats(0.2, 3.0))
def test_noise_is_found_from_the_level_at_rest(sigma: float) -> None:
    rest = float(expected_counts(np.array(0.0), sigma, CONVERTER))
    if 1e-3 < rest <= 1.5:
        assert noise_from_rest(rest, CONVERTER) == pytest.approx(sigma, rel=0.05)


def test_an_implausible_rest_level_bounds_no_noise() -> None:
    assert np.isnan(noise_from_rest(8.0, CONVERTER))
    assert np.isnan(noise_from_rest(0.4, Readout(None, None, True)))


def _counts(values: np.ndarray, sigma: float, frames: int, seed: int = 1) -> np.ndarray:
    rng = np.random.default_rng(seed)
    noisy = values[:, None] + sigma * rng.standard_normal((len(values), frames, values.shape[1]))
    return np.clip(np.rint(noisy), 0, 255).mean(axis=1)


def test_untouched_clipped_taxels_come_out_at_zero() -> None:
    values = np.zeros((60, 6))
    values[::5, 2] = 60.0
    seen = observe(_counts(values, 1.0, 400), CONVERTER)
    assert seen.frame_sigma_counts == pytest.approx(1.0, abs=0.05)
    assert np.abs(seen.values - values).max() < 0.6
    assert np.abs(seen.values[:, 0].mean()) < 0.05
    assert (seen.rest_counts == 0).all()
    assert seen.slope[0, 2] == pytest.approx(1.0)
    assert 0.3 < seen.slope[0, 0] < 0.7


def test_a_taxel_with_an_offset_of_its_own_is_brought_to_zero() -> None:
    values = np.zeros((60, 6))
    values[:, 4] = 3.0
    values[::5, 2] += 60.0
    seen = observe(_counts(values, 1.0, 100), CONVERTER)
    assert seen.rest_counts[4] == pytest.approx(3.0, abs=0.1)
    assert seen.values[:, 4].mean() == pytest.approx(0.0, abs=0.1)


def test_a_sensor_without_a_lower_bound_loses_its_level_at_rest() -> None:
    values = np.full((30, 4), 20.0)
    values[::4, 1] += 50.0
    seen = observe(values, Readout(None, None, False))
    assert seen.rest_counts == pytest.approx(np.full(4, 20.0))
    assert seen.values[0, 1] == pytest.approx(50.0)


def test_saturated_values_are_marked_and_dead_stay_nan() -> None:
    counts = np.full((12, 3), 0.4)
    counts[:4, 0] = 255.0
    counts[:, 2] = np.nan
    seen = observe(counts, CONVERTER)
    assert seen.saturated[:4, 0].all() and not seen.saturated[4:].any()
    assert np.isnan(seen.values[:, 2]).all()


def test_where_rest_was_taken_off_no_bound_lifts_anything() -> None:
    around = np.linspace(-3.0, 300.0, 50)
    assert np.array_equal(expected_counts(around, 1.0, Readout(0, 255, True, rest_subtracted=True)), around)


def test_a_subtracted_level_at_rest_is_not_taken_off_twice() -> None:
    counts = np.full((20, 2), 0.4)
    assert observe(counts, Readout(0, 255, True, rest_subtracted=True)).values == pytest.approx(counts)


@pytest.mark.parametrize("integer", [True, False])
@pytest.mark.parametrize(("value", "sigma"), [(0.0, 0.5), (0.0, 1.0), (1.5, 2.0), (120.0, 1.0)])
def test_clipping_takes_its_share_of_the_scatter(value: float, sigma: float, integer: bool) -> None:
    frames = value + sigma * np.random.default_rng(5).standard_normal(200_000)
    free = np.rint(frames) if integer else frames
    share = np.clip(free, 0, 255).std() / free.std()
    assert clipped_share(value, sigma, Readout(0, 255, integer)) == pytest.approx(share, rel=0.01)


@pytest.mark.parametrize("frames", [1, 25])
def test_levels_near_the_noise_are_found_in_any_unit(frames: int) -> None:
    """Taxels of a sensor in volts that rest a little above the bound, each elsewhere, with as much noise."""
    rng = np.random.default_rng(7)
    sigma, levels = 0.045, np.abs(0.045 + 0.03 * rng.standard_normal(16))
    values = levels + np.where(rng.random((60, 16)) < 0.2, rng.uniform(0.4, 5.0, (60, 16)), 0.0)
    noisy = values[:, None] + sigma * rng.standard_normal((60, frames, 16))
    seen = observe(np.clip(noisy, 0, None).mean(axis=1), Readout(0.0, None, False))
    # Of means of many frames only the scatters of levels tell how much the bound leaves of the noise.
    assert seen.frame_sigma_counts == pytest.approx(sigma, rel=0.3 if frames == 1 else 0.6)
    assert np.sqrt(np.mean((seen.rest_counts - levels) ** 2)) < 0.4 * sigma
    assert seen.level_sigma_counts.max() > 0.5 * np.std(levels)
    again = observe(1e3 * np.clip(noisy, 0, None).mean(axis=1), Readout(0.0, None, False))
    assert again.rest_counts == pytest.approx(1e3 * seen.rest_counts, abs=0.5)
    assert again.frame_sigma_counts == pytest.approx(1e3 * seen.frame_sigma_counts, rel=1e-3)


def test_a_converter_in_volts_saturates_at_its_bound_only() -> None:
    counts = np.abs(0.02 * np.random.default_rng(8).standard_normal((40, 4)))
    counts[::5, 0], counts[1::5, 1] = 4.7, 5.0
    seen = observe(counts, Readout(0.0, 5.0, False))
    assert not seen.saturated[:, 0].any() and seen.saturated[1::5, 1].all()


def test_rounded_frames_on_the_bound_tell_their_noise() -> None:
    """Steps as large as the noise are no half of a normal distribution: the lift of the level tells it."""
    found = []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        counts = rng.standard_normal((60, 16))
        lit = rng.random((60, 16)) < 0.25
        counts[lit] += rng.uniform(20.0, 120.0, lit.sum())
        seen = observe(np.clip(np.rint(counts), 0, 255), Readout(0.0, 255.0, True))
        found.append(seen.frame_sigma_counts)
    assert 0.85 < np.mean(found) < 1.04
