"""What a taxel does alone under a pressure that all feel, told from what all have in common."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from chambers import SIGMA
from gap.test_faults import chamber

from skincal.gap.apart import own_variance
from skincal.gap.reading import Reading


def reading(change: np.ndarray | None = None, memory: float = 0.0) -> Reading:
    """Of a chamber's session, with more counts (N, J)."""
    ready = chamber(memory=memory)
    one = ready.reading
    return one if change is None else one.with_counts(np.clip(one.counts + change, 0.0, 255.0))


def own(of: Reading) -> np.ndarray:
    session = chamber().session
    return np.sqrt(own_variance(session, of, np.ones(len(session), dtype=bool)))


@pytest.mark.parametrize("memory", [0.0, 0.05])
def test_what_all_taxels_do_alike_is_nobody_s_own(memory: float):
    assert own(reading(memory=memory)).max() < 0.3 * SIGMA


def test_a_taxel_that_wanders_does_so_alone():
    session = chamber().session
    wave = np.zeros((len(session), 16))
    wave[:, 3] = 6.0 * np.sin(np.arange(len(session)) / 12.0)
    found = own(reading(wave))
    assert 2.0 < found[3] < 8.0
    assert np.delete(found, 3).max() < 0.5 * SIGMA


def test_a_taxel_that_sticks_is_not_allowed_for():
    session = chamber().session
    stuck = np.zeros((len(session), 16))
    stuck[len(session) // 3 :, 5] = 255.0
    assert own(reading(stuck))[5] < 0.5 * SIGMA


def test_few_taxels_have_no_middle_one():
    ready = chamber()
    few = replace(
        ready.reading,
        counts=ready.reading.counts[:, :4],
        trust=ready.reading.trust[:, :4],
        further=ready.reading.further[:, :4],
        lift=ready.reading.lift[:, :4],
        sigma_counts=ready.reading.sigma_counts[:4],
    )
    assert not own_variance(ready.session, few, np.ones(len(ready.session), dtype=bool)).any()


def test_what_no_taxel_shows_is_left_out():
    """A plateau at which all taxels sit at a bound, and one that is not believed."""
    session, one = chamber().session, reading()
    counts, trust = one.counts.copy(), one.trust.copy()
    first, last = np.flatnonzero(session.press == 2), np.flatnonzero(session.press == 6)
    counts[first[:2]], counts[first[2:]], trust[last] = 0.0, 255.0, 0.0
    assert own(replace(one, counts=counts, trust=trust)).max() < 0.5 * SIGMA
