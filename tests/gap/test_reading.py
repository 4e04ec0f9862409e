"""Residuals are standard deviations of what is read, and weights their slopes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gap.gap_sessions import READOUT, full
from gap.made_sessions import OPEN, SIGMA, made, pressed, read

from skincal.fit.observe import Readout
from skincal.gap.reading import Reading

VALUES = np.array([0.0, 0.4, 1.5, 8.0, 60.0, 253.9, 255.0])


def reading_of(values: np.ndarray, frames: int, readout: Readout, seed: int = 0) -> Reading:
    """Rows of means of so many frames at values (J,)."""
    session = replace(pressed(), frames=np.full(len(pressed()), float(frames)))
    whole = np.broadcast_to(values, (len(session), len(values)))
    counts = read(session, whole, np.random.default_rng(seed), readout)
    return Reading.of(replace(session, counts=counts), SIGMA, readout)


@pytest.mark.parametrize("readout", [READOUT, OPEN, Readout(0, None, integer=False)])
@pytest.mark.parametrize("frames", [1, 12])
def test_residuals_of_the_truth_are_standard_normal(readout: Readout, frames: int):
    reading = reading_of(VALUES, frames, readout)
    residual = reading.residual(np.broadcast_to(VALUES, reading.counts.shape))
    many = len(residual)
    assert np.abs(residual.mean(axis=0)).max() < 4 / np.sqrt(many)
    # The square of what is nearly always clipped has long tails, so its mean is less certain.
    assert residual.std(axis=0) == pytest.approx(np.ones(len(VALUES)), abs=0.17)


def test_each_taxel_has_its_own_noise():
    session = replace(pressed(), frames=np.full(len(pressed()), 4.0))
    counts = np.broadcast_to(VALUES + 0.3, (len(session), len(VALUES)))
    session = replace(session, counts=counts)
    noise = np.array([1.0, 1.0, 5.0, 1.0, 5.0, 2.0, 1.0])
    whole = Reading.of(session, noise, READOUT)
    values = np.broadcast_to(VALUES, counts.shape)
    for j, sigma in enumerate(noise.tolist()):
        alone = Reading.of(session, sigma, READOUT)
        for what in ("deviation", "expected", "residual", "weight"):
            assert getattr(whole, what)(values)[:, j] == pytest.approx(
                getattr(alone, what)(values)[:, j], rel=1e-9
            )
        assert whole.expected_of(j, values[:, j]) == pytest.approx(alone.expected(values)[:, j], abs=1e-4)


def test_residuals_of_a_true_model_are_standard_normal():
    one = made()
    residual = one.reading.residual(one.truth.values(one.session))
    rest = one.session.press < 0
    for part in (residual, residual[rest], residual[one.truth.values(one.session) > 5]):
        assert np.mean(part**2) == pytest.approx(1.0, abs=5 * np.sqrt(2 / part.size))
        assert abs(part.mean()) < 4 / np.sqrt(part.size)


@pytest.mark.parametrize("readout", [READOUT, OPEN])
def test_weight_is_the_slope_of_the_residual(readout: Readout):
    reading = reading_of(VALUES, 4, readout)
    values, step = np.broadcast_to(VALUES, reading.counts.shape), 0.01
    # Of the mean, at the noise that is there: noise that shrinks towards a bound is no slope.
    rise = reading.expected(values + step) - reading.expected(values - step)
    slope = rise / (2 * step) / reading.deviation(values)
    assert reading.weight(values) == pytest.approx(slope, rel=0.02, abs=1e-3)
    assert reading.weight(np.full_like(values, 40.0))[0, 0] == pytest.approx(
        2 / np.hypot(1.0, (1 / 12) ** 0.5 if readout.integer else 0.0)
    )


def test_what_was_not_read_has_no_residual_and_no_weight():
    one = made()
    counts = one.session.counts.copy()
    counts[5, 2] = np.nan
    reading = Reading.of(replace(one.session, counts=counts), SIGMA, READOUT)
    values = one.truth.values(one.session)
    whole, part = one.reading.residual(values), reading.residual(values)
    assert part[5, 2] == 0 and reading.weight(values)[5, 2] == 0 and not reading.seen[5, 2]
    assert (whole != part).sum() == 1
    assert np.isnan(reading.with_counts(values).counts[5, 2])


def test_half_the_trust_is_half_the_square():
    one = made()
    values = one.truth.values(one.session)
    doubted = one.reading.trusting(np.full_like(values, 0.5))
    assert doubted.residual(values) ** 2 == pytest.approx(one.reading.residual(values) ** 2 / 2)
    assert doubted.weight(values) ** 2 == pytest.approx(one.reading.weight(values) ** 2 / 2)
    gone = doubted.trusting(np.zeros((len(values), 1)))
    assert not gone.seen.any() and not gone.residual(values).any()


def test_further_noise_adds_to_that_of_the_taxels():
    one, rng = made(), np.random.default_rng(3)
    values = one.truth.values(one.session)
    extra = np.full_like(values, 4.0)
    counts = one.session.counts + 2.0 * rng.standard_normal(values.shape)
    reading = Reading.of(replace(one.session, counts=counts), SIGMA, READOUT).with_further(extra)
    assert reading.deviation(values) ** 2 == pytest.approx(one.reading.deviation(values) ** 2 + 4)
    assert np.mean(reading.residual(values) ** 2) == pytest.approx(1.0, abs=0.1)


def test_a_plan_was_not_read():
    with pytest.raises(ValueError, match="got a plan"):
        Reading.of(full(4), 1.0, READOUT)
