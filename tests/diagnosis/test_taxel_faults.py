"""Detection of taxels that step or are stuck, and no detection of what effects do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from effects.effect_sessions import contacts_at

from skincal.diagnosis.taxel_faults import block_keys, detect_faults, remove_faults
from skincal.effects import Samples
from skincal.effects.samples import HOLD, IDLE, LOAD, UNLOAD
from skincal.inference.session import GapSession
from skincal.model import Sphere

PRESSES, TAXELS, SIGMA = 40, 6, 1.0
PARTS = [(LOAD, 0.5), (HOLD, 1.0), (HOLD, 1.0), (UNLOAD, 0.5), (IDLE, 0.0)]


def session(seed: int = 0) -> tuple[GapSession, np.ndarray]:
    """Return presses with a rest after each, and the predicted counts of six taxels that rest at 20."""
    rng = np.random.default_rng(seed)
    light = rng.uniform(0, 100, (PRESSES, TAXELS)) * (rng.random((PRESSES, TAXELS)) < 0.7)
    press = np.repeat(np.arange(PRESSES), len(PARTS))
    phase = np.tile([p for p, _ in PARTS], PRESSES)
    part = np.tile([share for _, share in PARTS], PRESSES)
    row = np.where(phase == IDLE, -1, press)
    count = len(row)
    samples = Samples.of(
        contacts_at(np.zeros(count), np.zeros(count), np.maximum(part, 0.1)),
        Sphere(0.006),
        press=row,
        touching=row >= 0,
        time_s=np.arange(count) * 0.5,
        phase=phase,
    )
    observed = GapSession(samples, row, np.arange(count), row, phase, np.full(count, 4.0))
    return observed, 20 + part[:, None] * light[press]


def read(expected: np.ndarray, seed: int = 1) -> np.ndarray:
    return expected + SIGMA / 2 * np.random.default_rng(seed).standard_normal(expected.shape)


def faults(observed: GapSession, counts: np.ndarray, expected: np.ndarray, *, calibrated: bool = False):
    variance = np.full(counts.shape, SIGMA**2 / 4)
    return detect_faults(
        observed, counts, expected, variance, expected - 20, (0.0, 255.0), calibrated=calibrated
    )


def test_block_keys_of_presses_and_rests():
    keys = block_keys(np.array([-1, -1, 3, 3, -1, 5, -1]))
    assert keys.tolist() == [-1, -1, 3, 3, -5, 5, -7]


def test_simultaneous_steps_are_removed():
    observed, expected = session()
    counts = read(expected)
    during = (observed.press >= 10) & (observed.press < 25)
    during |= np.isin(block_keys(observed.press), -2 - np.arange(10, 25))
    counts[np.ix_(during, [1, 4])] += [8.0, -5.0]
    found = faults(observed, counts, expected)
    assert [(one.taxel, one.press, one.stuck, one.lasts) for one in found] == [
        (1, 10, False, False),
        (4, 10, False, False),
    ]
    assert [one.counts for one in found] == pytest.approx([8.0, -5.0], abs=0.6)

    left = remove_faults(replace(observed, counts=counts), found).counts
    assert left is not None and np.abs(left - expected).max() < 4 * SIGMA


def test_step_lasts_to_the_end():
    observed, expected = session(2)
    counts = read(expected)
    counts[100:, 2] += 6.0
    (one,) = faults(observed, counts, expected)
    assert (one.taxel, one.press, one.lasts) == (2, 20, True)
    assert one.counts == pytest.approx(6.0, abs=0.6)


@pytest.mark.parametrize("level", [255.0, 20.0])
def test_stuck_taxel_is_detected(level: float):
    observed, expected = session(3)
    counts = read(expected)
    during = slice(50, 80)
    counts[during, 3] = level
    (one,) = faults(observed, counts, expected)
    assert one.stuck and (one.taxel, one.counts) == (3, pytest.approx(level, abs=1.0))
    assert set(range(10, 16)) <= set(one.blocks.tolist())


@pytest.mark.parametrize("level", [255.0, 0.0])
def test_taxel_at_converter_end_is_ignored(level: float):
    observed, expected = session(5)
    counts = read(expected)
    counts[:, 3] = level
    (one,) = faults(observed, counts, expected, calibrated=True)
    assert one.stuck and one.lasts and one.taxel == 3
    left = remove_faults(replace(observed, counts=counts), [one])
    assert left.counts is not None and np.isnan(left.counts[:, 3]).all()
    assert faults(observed, left.counts, expected) == ()


def test_first_and_last_stuck_press_are_included():
    observed, expected = session(6)
    counts = read(expected)
    counts[53:82, 3] = 255.0  # from the unloading of one press to the first rise of another
    (one,) = faults(observed, counts, expected, calibrated=True)
    assert {10, 16} <= set(one.blocks.tolist())


def test_plateau_is_not_stuck():
    """A plateau of a load staircase is flat within the noise, and a wrong calibration may predict other values."""
    observed, _ = session(7)
    load = np.repeat(np.linspace(0, 60, PRESSES), len(PARTS))[:, None]
    counts = read(20 + np.tile(load, TAXELS))
    assert faults(observed, counts, 20 + 2 * np.tile(load, TAXELS), calibrated=True) == ()


@pytest.mark.parametrize(
    "change",
    [
        lambda c, e, t: c,
        lambda c, e, t: c + 10 * np.exp(-t / 20),  # a level that settles
        lambda c, e, t: 20 + (c - 20) * (1 + 0.3 * t / t.max()),  # a gain that drifts
        lambda c, e, t: 20 + 100 * np.tanh((c - 20) / 100),  # saturation
        lambda c, e, t: np.where(t > 60, np.where(np.arange(TAXELS) == 2, 20.0, c), c),  # a taxel that dies
        lambda c, e, t: c + 4 * np.eye(TAXELS)[1],  # a level of its own
    ],
)
def test_effects_are_not_faults(change):
    observed, expected = session(4)
    time = observed.samples.elapsed_s[:, None]
    for calibrated in (False, True):
        assert faults(observed, change(read(expected), expected, time), expected, calibrated=calibrated) == ()
