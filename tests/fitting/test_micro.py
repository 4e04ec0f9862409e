"""Both ways of the micro problems: nlopt on the skin model, and Gauss-Newton on tables."""

from __future__ import annotations

import math
from dataclasses import dataclass

import nlopt
import numpy as np
import pytest

from skincal.fitting import grid
from skincal.fitting.general import Combination, evaluate_pose, micro_objective, nlopt_micro, slack_lattice
from skincal.fitting.general_skin import SkinShares
from skincal.fitting.grid import MacroGrid, MicroSettings, place_presses
from skincal.fitting.problem import FitProblem, build_problem
from tests.fitting.conftest import Truth, make_session, rig
from tests.fitting.geometry import general_problem

SETTINGS = MicroSettings(0.5, 1e-3, 2e-3)
OFFSETS = (
    (0.0, 0.0, 0.0, 0.0),
    (0.3e-3, -0.2e-3, 0.0, 0.0),
    (-0.3e-3, 0.3e-3, 0.04, 0.2),
    (0.6e-3, 0.0, -0.05, -0.25),
    (1.0e-3, -1.0e-3, 0.1, 0.5),
)


@dataclass(frozen=True)
class _Both:
    """One combination, by both ways. The objective of the fast way's places is taken on the skin model, too."""

    nlopt: Combination
    fast_slack_m: np.ndarray
    fast_objective: np.ndarray
    fast_mse_counts2: float
    fast_scale_per_n: float

    @property
    def worse(self) -> np.ndarray:
        """Excess of the compiled solver's objective over that of nlopt (K,)."""
        return self.fast_objective - self.nlopt.objective

    @property
    def apart_m(self) -> np.ndarray:
        return np.abs(self.fast_slack_m - self.nlopt.slack_m).max(axis=1)


@pytest.fixture(scope="module")
def both() -> list[_Both]:
    truth = Truth()
    centre = truth.macro[:4]
    found = []
    for seed in (0, 5):
        table, _ = make_session(truth, presses=20, seed=seed)
        general, fast = general_problem(table), build_problem(rig(), table, min_active=2)
        assert len(fast) >= 10
        found += [_evaluate(general, fast, centre + offset) for offset in OFFSETS]
    return found


def _evaluate(general: FitProblem, fast: FitProblem, macro: np.ndarray) -> _Both:
    slack, mse, scale = _fast(fast, macro)
    skin, weight = SkinShares(general, *macro[:3]), fast.weight
    shares = skin.shares(np.arange(len(fast)), slack, np.log(fast.force_n) - macro[3]) * weight
    objective = micro_objective(fast.values * weight, shares, slack, SETTINGS)
    return _Both(evaluate_pose(general, skin, macro[3:], SETTINGS)[0], slack, objective, mse, scale)


def _fast(problem: FitProblem, macro: np.ndarray) -> tuple[np.ndarray, float, float]:
    """Slacks, loss and scale of the grid's own code at one combination."""
    found = []

    def watched(*arguments):
        found.append(place_presses(*arguments))
        return found[-1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(grid, "place_presses", watched)
        slab = grid.evaluate_slab(problem, MacroGrid(*(macro[i : i + 1] for i in range(4))), 0, SETTINGS)
    return found[0][0][:, 0, 0], float(slab.mse_counts2[0, 0, 0]), float(slab.scale_per_n[0, 0, 0])


def test_both_ways_find_places_that_are_equally_good(both: list[_Both]) -> None:
    """The objective has several minima, and either way may miss the best: rarely, and then of either side.

    The model's points lie 0.25 mm apart, the tables are continuous: that alone is worth a tenth of a squared sigma.
    """
    worse = np.concatenate([b.worse for b in both])
    assert len(worse) >= 100
    assert (np.abs(worse) < 0.15).mean() > 0.9
    assert (worse > 1.0).mean() < 0.03
    assert (worse < -1.0).mean() < 0.03


def test_both_ways_find_the_same_places(both: list[_Both]) -> None:
    """To 0.1 mm where both have found the same minimum; a flat one over the middle of a taxel is found less well."""
    same = np.concatenate([b.apart_m[np.abs(b.worse) < 0.15] for b in both])
    assert np.median(same) < 0.01e-3
    assert (same < 0.1e-3).mean() > 0.9


def test_both_solvers_give_equal_loss_at_equal_places(both: list[_Both]) -> None:
    """Two places of a press may look alike once images are normalised, and not at all with the common scale."""
    same = [b for b in both if b.apart_m.max() < 0.3e-3]
    assert len(same) >= 4
    for b in same:
        assert b.fast_scale_per_n == pytest.approx(b.nlopt.scale_per_n, rel=0.02)
        assert b.fast_mse_counts2 == pytest.approx(b.nlopt.mse_counts2, rel=0.1, abs=0.2)


def _blobs(slack: np.ndarray, centres: np.ndarray) -> np.ndarray:
    away = slack[:, None, :] - centres
    return np.exp(-(away**2).sum(axis=2) / 3e-6)


@pytest.mark.parametrize("start", [[1e-3, 0.0], [0.5e-3, 0.5e-3]])
def test_nlopt_finds_a_place_it_cannot_miss(start: list[float]) -> None:
    rng = np.random.default_rng(3)
    centres = rng.uniform(-3e-3, 3e-3, (16, 2))
    truth = np.array([[0.8e-3, 0.2e-3]])
    observed = 70 * _blobs(truth, centres)[0]
    settings = MicroSettings(0.5, math.inf, 2e-3)
    slack, q = nlopt_micro(observed, lambda s: _blobs(s, centres), settings, np.array(start))
    assert slack == pytest.approx(truth[0], abs=1e-6)
    assert q == pytest.approx(0.0, abs=1e-3)


def test_nlopt_stays_within_the_slack() -> None:
    rng = np.random.default_rng(3)
    centres = rng.uniform(-3e-3, 3e-3, (16, 2))
    observed = 70 * _blobs(np.array([[2.6e-3, 0.0]]), centres)[0]
    settings, start = MicroSettings(0.5, 1e-3, 2e-3), np.array([2e-3, 0.0])
    slack, _ = nlopt_micro(observed, lambda s: _blobs(s, centres), settings, start)
    assert slack[0] == pytest.approx(2e-3, abs=1e-5)
    assert np.abs(slack).max() <= 2e-3


def test_without_slack_the_measured_place_is_taken() -> None:
    observed = np.array([1.0, 2.0])
    settings = MicroSettings(0.5, 1e-3, 0.0)
    slack, q = nlopt_micro(observed, lambda s: np.ones((len(s), 2)), settings, np.zeros(2))
    assert (slack == 0).all()
    assert q == pytest.approx(2.0)


def test_the_lattice_holds_the_corners_and_the_middle() -> None:
    lattice = slack_lattice(2e-3)
    assert len(lattice) == 81
    assert np.abs(lattice).max() == 2e-3
    assert (lattice == 0).all(axis=1).any()
    assert len(slack_lattice(0.0)) == 1
    assert len(slack_lattice(20e-3)) == 17**2


@pytest.mark.parametrize("error", [nlopt.RoundoffLimited, nlopt.runtime_error])
def test_where_nlopt_gives_up_the_best_place_seen_stands(
    monkeypatch: pytest.MonkeyPatch, error: type[Exception]
) -> None:
    class Stubborn(nlopt.opt):
        def optimize(self, start):
            super().optimize(start)
            raise error("no further")

    monkeypatch.setattr(nlopt, "opt", Stubborn)
    test_nlopt_finds_a_place_it_cannot_miss([1e-3, 0.0])
