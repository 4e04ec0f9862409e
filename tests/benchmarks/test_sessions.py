"""Sessions are what they say: reproducible, spoiled as declared, and right where two contact laws must agree."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import norm

from benchmarks.sessions import (
    CYLINDER_RADIUS_M,
    GRID_M,
    SLACK_M,
    Y_M,
    Law,
    Truth,
    hold_means,
    make_session,
    taxel_loads,
)
from skincal.dataset import read_dataset, write_dataset

TRUTH = Truth("foundation", 0.0241, 4.0, -9.0, 4e8, 70.0, 0.8e-3, 0.3e-3, -0.2e-3)


@pytest.mark.parametrize("law", ["foundation", "layer"])
def test_sessions_are_reproducible_and_read_back(law: Law, tmp_path: Path) -> None:
    (first, truth), (again, _) = (make_session(np.random.default_rng(5), law, presses=12) for _ in range(2))
    write_dataset(first, tmp_path / "session")
    read = read_dataset(tmp_path / "session")
    for session in (again, read):
        np.testing.assert_array_equal(session.presses.counts, first.presses.counts)
        np.testing.assert_array_equal(session.presses.position_m, first.presses.position_m)
    assert truth.law == law
    assert (truth.thickness_m is None) == (law == "foundation")


def test_errors_are_those_declared() -> None:
    rng = np.random.default_rng(11)
    for _ in range(20):
        session, truth = make_session(rng, presses=225, position_sigma_m=0.7e-3)
        x, y, z = session.presses.position_m.T
        # All 225 places of the grid are pressed, so the scatter of the true ones is known.
        assert np.hypot(x, z) == pytest.approx(CYLINDER_RADIUS_M, abs=1e-7)
        arc = CYLINDER_RADIUS_M * np.arctan2(x, z)
        half = 7 * GRID_M
        for measured, middle, constant in ((arc, 0.0, truth.constant_arc_m), (y, Y_M, truth.constant_y_m)):
            grid = np.sqrt(np.mean(np.square(np.arange(-7, 8) * GRID_M)))
            assert measured.mean() - middle == pytest.approx(constant, abs=4 * 0.7e-3 / 15)
            assert np.std(measured) == pytest.approx(np.hypot(grid, 0.68e-3), rel=0.03)
            assert np.abs(measured - middle).max() <= half + SLACK_M
        assert 0.98 < session.presses.force_n.min() < session.presses.force_n.max() < 4.09


def test_constant_error_is_reported_as_pose() -> None:
    told = TRUTH.as_positions_tell
    assert told.y_m == pytest.approx(0.0239)
    assert np.radians(told.beta_deg - 4.0) * CYLINDER_RADIUS_M == pytest.approx(0.3e-3)
    assert (told.constant_arc_m, told.constant_y_m) == (0.0, 0.0)
    assert told.elasticity_pa_per_m == TRUTH.elasticity_pa_per_m


def test_thin_layer_gives_the_images_of_the_foundation() -> None:
    # Two codes that share nothing: also frames, angles and taxel numbers must be the same.
    rng = np.random.default_rng(2)
    arc, y = rng.uniform(-6e-3, 6e-3, 6), Y_M + rng.uniform(-6e-3, 6e-3, 6)
    force = rng.uniform(1.0, 4.0, 6)
    foundation = taxel_loads(TRUTH, arc, y, force)
    thin = taxel_loads(replace(TRUTH, law="layer", thickness_m=0.02e-3, poisson=0.3), arc, y, force)
    assert np.abs(thin - foundation).max() < 0.005 * foundation.max()
    thick = taxel_loads(replace(TRUTH, law="layer", thickness_m=2e-3, poisson=0.4), arc, y, force)
    assert np.abs(thick - foundation).max() > 0.03 * foundation.max()


def test_holds_are_means_of_clipped_whole_counts() -> None:
    counts = hold_means(np.random.default_rng(0), np.repeat([[0.0, 100.0, 300.0]], 4000, axis=0))
    rest = norm.sf(np.arange(1, 8) - 0.5).sum()
    assert counts.mean(axis=0) == pytest.approx([rest, 100.0, 255.0], abs=0.01)
    assert counts[:, 1].std() == pytest.approx(np.sqrt(1 + 1 / 12) / 5, rel=0.05)
    np.testing.assert_array_equal(counts, np.round(counts, 2))


def test_more_presses_than_places_are_refused() -> None:
    with pytest.raises(ValueError, match="at most 225"):
        make_session(np.random.default_rng(0), presses=226)
