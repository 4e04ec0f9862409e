from __future__ import annotations

import pickle
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from skincal.fitting.general import image_mismatch
from skincal.fitting.grid import MacroGrid, MicroSettings, evaluate_slab, span
from skincal.fitting.kernel import build_table
from skincal.fitting.lookup import compiled
from skincal.fitting.problem import build_problem
from skincal.fitting.slab import descend, mismatches, place
from skincal.fitting.types import Floats
from tests.fitting.conftest import Truth, make_session, rig

SETTINGS = MicroSettings(0.5, 1e-3, 2e-3)


mismatched: Any = compiled(mismatches.py_func)  # type: ignore[attr-defined]
descended: Any = compiled(descend.py_func)  # type: ignore[attr-defined]


def test_span_holds_both_ends_and_is_no_coarser_than_asked() -> None:
    values = span(-2.4e-3, 2.4e-3, 1e-3)
    assert values[0] == -2.4e-3 and values[-1] == 2.4e-3
    assert np.diff(values).max() <= 1e-3 + 1e-12
    assert list(span(1.0, 1.0, 0.5)) == [1.0]
    assert len(span(0.0, 1.0, 0.25)) == 5


def test_mismatch_ignores_the_scale_of_the_simulated_image() -> None:
    rng = np.random.default_rng(0)
    observed, shares = rng.uniform(0, 50, (2, 8, 16))
    assert image_mismatch(observed, shares) == pytest.approx(image_mismatch(observed, 37.0 * shares))
    assert image_mismatch(observed, observed * 0.1) == pytest.approx(np.zeros(8), abs=1e-8)


def test_gauss_newton_stays_in_the_slack_and_descends(truth: Truth) -> None:
    """From where the rig saw the presses, with slack that is worth nothing, to where they were."""
    problem = build_problem(rig(), make_session(truth, presses=30, noise=0.0, position_sigma_m=0.4e-3)[0])
    log_ratio = np.log(problem.force_n) - np.log(truth.elasticity_pa_per_m)
    parts = problem.rig.surface, problem.rig.indenters, problem.rig.layout
    table = build_table(*parts, np.array([truth.alpha_rad]), (log_ratio.min(), log_ratio.max()))
    (planes, lattice), layout = table.level(0, log_ratio, problem.indenter), problem.rig.layout
    room = np.empty((3, layout.taxels)), np.empty(layout.taxels, dtype=np.int64)
    turn, settings = (np.cos(truth.alpha_rad), np.sin(truth.alpha_rad)), (4.0, 0.0, 0.5e-3)
    left = []
    for k in range(len(problem)):
        tables = planes, table.size_of, layout.centres_m, lattice, k
        at = problem.across_m[k] - truth.across_m, problem.along_m[k] - truth.y_m
        given, before, slack = (
            (tables, problem.weight[k], problem.values[k], at, turn),
            np.empty((1, 1)),
            np.zeros(2),
        )
        mismatched(*given[:3], np.array(at[:1]), np.array(at[1:]), turn, before)
        q = descended(*given, settings, slack, room, np.empty(layout.taxels))
        assert np.abs(slack).max() <= 0.5e-3
        # The lattice is read at its nearest node.
        assert q <= 4.0 * before[0, 0] * 1.05 + 1.0
        left.append(q)
    assert np.median(left) < 1.0


def test_the_grid_finds_the_truth_where_there_is_no_noise(truth: Truth) -> None:
    problem = build_problem(rig(), make_session(truth, presses=20, noise=0.0, position_sigma_m=0.0)[0])
    grid = MacroGrid(
        np.array([-1.0e-3, truth.across_m, 1.8e-3]),
        np.array([truth.y_m - 1e-3, truth.y_m, truth.y_m + 1e-3]),
        np.array([truth.alpha_rad]),
        np.log(truth.elasticity_pa_per_m) + np.array([-1.0, 0.0, 1.0]),
    )
    slab = evaluate_slab(problem, grid, 0, SETTINGS)
    assert slab.mse_counts2.shape == (3, 3, 3)
    e = np.unravel_index(slab.mse_counts2.argmin(), slab.mse_counts2.shape)[0]
    assert e == 1
    assert slab.mse_counts2[1, 1, 1] < 0.3
    assert slab.scale_per_n[1, 1, 1] == pytest.approx(truth.scale_per_n, rel=0.01)
    # The slack takes up a shift of the sensor: position is told by how little of it is needed.
    assert np.unravel_index(slab.slack_rms_m[1].argmin(), (3, 3)) == (1, 1)


def test_another_process_needs_no_other_compilation(truth: Truth) -> None:
    """Read-only arrays are writable once they have been sent, which is another type."""
    presses, _ = make_session(truth, presses=6, noise=0.0, position_sigma_m=0.4e-3)
    one: Floats = np.zeros(1)
    macro = MacroGrid(one, one, one, np.log([truth.elasticity_pa_per_m]))
    task = build_problem(rig(), presses), macro, 0, SETTINGS
    compiled: Any = place
    evaluate_slab(*task)
    before = list(compiled.signatures)
    evaluate_slab(*pickle.loads(pickle.dumps(task)))
    assert compiled.signatures == before


def test_a_search_window_belongs_to_its_own_centre(truth: Truth) -> None:
    """With the sensor's centre and the presses moved alike, every combination gives the same loss."""
    problem = build_problem(rig(), make_session(truth, presses=12, noise=0.0)[0])
    log_e = np.log(truth.elasticity_pa_per_m)
    across = np.array([-0.6e-3, 0.4e-3, 1.4e-3])
    y = np.array([0.0228, 0.0238])
    whole = evaluate_slab(
        problem, MacroGrid(across, y, np.array([truth.alpha_rad]), np.array([log_e])), 0, SETTINGS
    )
    for i, x in enumerate(across):
        for j, centre in enumerate(y):
            one = MacroGrid(np.array([x]), np.array([centre]), np.array([truth.alpha_rad]), np.array([log_e]))
            alone = evaluate_slab(problem, one, 0, SETTINGS)
            assert alone.mse_counts2[0, 0, 0] == pytest.approx(whole.mse_counts2[0, i, j], rel=0.05, abs=0.02)


def test_presses_are_chosen_by_their_active_taxels(truth: Truth) -> None:
    presses, _ = make_session(truth, presses=40)
    problem = build_problem(rig(), presses)
    active = (presses.counts > 5.4).sum(axis=1)
    assert abs(len(problem) - (active >= 2).sum()) <= 1
    assert len(problem.status) == 40
    stricter = build_problem(rig(), presses, min_active=3)
    dropped = [s for s in stricter.status if s != "used"]
    assert dropped and all("active taxel" in s for s in dropped)
    assert len(stricter) < len(problem)


def test_presses_of_one_taxel_are_taken_where_others_are_few(truth: Truth) -> None:
    presses, _ = make_session(truth, presses=18)
    problem, paper = build_problem(rig(), presses), build_problem(rig(), presses, min_active=2)
    assert 5 <= len(paper) < 16
    assert len(problem) > len(paper) == len(problem.for_grid)


def test_presses_of_one_taxel_leave_identifiability_open(truth: Truth) -> None:
    problem = build_problem(rig(), make_session(truth, presses=40)[0], min_active=1)
    lit = problem.lit.sum(axis=1)
    chosen = np.isin(np.arange(len(lit)), [*np.flatnonzero(lit >= 3)[:6], *np.flatnonzero(lit == 1)[:5]])
    few = problem.subset(chosen, "another")
    assert few.determined == problem.subset(chosen & (lit > 1), "another").determined


def test_incomplete_presses_are_dropped_and_reported(truth: Truth) -> None:
    presses, _ = make_session(truth, presses=30)
    force, across, counts = presses.force_n.copy(), presses.across_m.copy(), presses.counts.copy()
    force[0], force[1], across[2], counts[3] = -1.0, np.nan, np.nan, np.nan
    status = build_problem(rig(), replace(presses, across_m=across, force_n=force, counts=counts)).status
    assert status[:4] == ("no positive force", "no positive force", "no position", "no taxel read")
