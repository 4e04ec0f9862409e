"""The noise that frames without a press show."""

import numpy as np
import pytest

from skincal.fit.observe import Readout
from skincal.gap.idle_noise import IdleNoise, idle_noise
from skincal.gap.noise import noise_floor

READOUT = Readout(0.0, 255.0, True)
NOTHING = (np.zeros(0), np.zeros(0))


def idle(
    sigma: float = 1.0, frames: int = 3000, seed: int = 0, level: float | np.ndarray = 0.0
) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.clip(np.rint(level + sigma * rng.normal(size=(frames, 16))), 0.0, 255.0)


@pytest.mark.parametrize(
    ("sigma", "level"),
    [(1.0, 0.0), (2.5, 0.0), (0.6, 0.4), (1.0, 0.4), (0.4, 12.0), (1.0, 12.0), (2.5, 12.0)],
)
def test_noise_is_found_though_the_converter_clips(sigma: float, level: float):
    found = idle_noise(idle(sigma, level=level), READOUT)
    assert found.sigma_counts == pytest.approx(sigma, abs=4 * found.error_counts)
    assert found.error_counts < 0.03 * sigma


def test_what_counts_of_two_kinds_cannot_tell_has_a_large_error():
    # At a level of 0 and with little noise, only 0 and 1 are ever read: that is one number, for a level and a sigma.
    found = idle_noise(idle(0.35), READOUT)
    assert not found.known or found.error_counts > 0.05 * found.sigma_counts
    assert not IdleNoise(0.17, 2.9).known


def test_the_standard_error_is_what_estimates_scatter_by():
    found = [idle_noise(idle(seed=seed), READOUT) for seed in range(40)]
    z = np.array([(f.sigma_counts - 1.0) / f.error_counts for f in found])
    assert abs(z.mean()) < 0.6 and 0.7 < z.std() < 1.3


def test_levels_of_taxels_and_slow_drift_are_not_noise():
    levels = np.linspace(0.0, 9.0, 16)
    slow = np.linspace(0.0, 0.5, 3000)[:, None]
    assert idle_noise(idle(level=levels + slow), READOUT).sigma_counts == pytest.approx(1.0, rel=0.03)


def test_a_glitch_and_a_jump_of_a_level_are_no_noise():
    clean = idle_noise(idle(), READOUT)
    glitch, jump, saw = idle(), idle(), idle()
    glitch[700, 3] = 30.0
    glitch[1500:1510, 5] += 12.0
    jump[1000:, 7] += 8.0
    saw[:, 2] += 6.0 * (np.arange(3000) % 40) / 40
    for counts in (glitch, jump, saw):
        found = idle_noise(counts, READOUT)
        assert found.known and abs(found.sigma_counts - clean.sigma_counts) < found.error_counts


def test_short_rests_of_many_taxels_are_not_biased_by_their_levels():
    rng = np.random.default_rng(3)
    found = [
        idle_noise(np.clip(np.rint(rng.normal(size=(400, 120))), 0.0, 255.0), READOUT).sigma_counts
        for _ in range(4)
    ]
    assert np.mean(found) == pytest.approx(1.0, abs=0.012)


def test_a_taxel_that_never_changes_and_missing_values_say_nothing():
    counts = idle()
    counts[:, 3], counts[:, 4] = 0.0, 255.0
    counts[::7, 5] = np.nan
    assert idle_noise(counts, READOUT).sigma_counts == pytest.approx(1.0, rel=0.03)


def test_a_long_session_takes_no_longer_than_what_is_enough(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("skincal.gap.idle_noise._ENOUGH", 64)
    part, whole = idle_noise(idle(frames=12_000), READOUT), idle_noise(idle(frames=2_400), READOUT)
    assert part.sigma_counts == pytest.approx(1.0, abs=4 * part.error_counts)
    assert part.error_counts == pytest.approx(whole.error_counts, rel=0.1)


def test_nothing_is_said_where_frames_cannot_tell():
    for counts, readout in (
        (idle(frames=40), READOUT),
        (np.zeros((3000, 16)), READOUT),
        (idle(), Readout(0.0, 255.0, False)),
        (idle(), Readout(None, 255.0, True)),
        (idle(), Readout(0.0, 255.0, True, rest_subtracted=True)),
    ):
        assert not idle_noise(counts, readout).known


def holds(sigma: float) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(1)
    freedom = np.full(60, 100.0)
    return (sigma**2 + 1 / 12) * rng.chisquare(100, 60), freedom


def floor_of(idle: IdleNoise | None, scatter: tuple[np.ndarray, np.ndarray]):
    rest = np.full(16, np.nan)
    return noise_floor(scatter, NOTHING, rest, np.nan, 25.0, READOUT, np.random.default_rng(0), idle)


def test_holds_and_idle_frames_are_taken_together_where_they_agree():
    alone, both = floor_of(None, holds(1.0)), floor_of(IdleNoise(1.0, 0.005), holds(1.0))
    assert both.frame_from == "hold and idle frames"
    assert abs(both.frame_counts - 1.0) < abs(alone.frame_counts - 1.0)
    width = [f.frame_interval[1] - f.frame_interval[0] for f in (alone, both)]
    assert width[1] < 0.7 * width[0]


def test_holds_are_believed_where_something_drifts_at_rest():
    drifting = floor_of(IdleNoise(2.9, 0.02), holds(1.0))
    assert drifting.frame_from == "hold frames" and drifting.frame_counts == pytest.approx(1.0, rel=0.05)


def test_few_holds_are_not_known_better_than_their_frames_tell():
    for count in (1, 2):
        few = np.full(count, 100.0 * (1.02**2 + 1 / 12)), np.full(count, 100.0)
        found = floor_of(IdleNoise(1.0, 0.005), few)
        assert found.frame_from == "hold and idle frames" and found.frame_counts == pytest.approx(
            1.0, abs=0.003
        )
        alone = floor_of(None, few)
        assert alone.frame_interval[0] < 0.95 and alone.frame_interval[1] > 1.09


def test_idle_frames_do_where_no_hold_can_be_read():
    found = floor_of(IdleNoise(1.2, 0.01), NOTHING)
    assert found.frame_from == "idle frames" and found.frame_counts == 1.2
    assert found.mean_counts == pytest.approx(np.hypot(1.2, 12**-0.5) / 5)
