"""The study of the whole chain: one short session of it, and what is made of its records."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from benchmarks import collect_chain
from benchmarks.collect_chain import Job, Seen, main, reached, run_job, summary, told_truth
from skincal.collect import Plan, PlannedPress
from skincal.fitting.fit_options import FitOptions


def short_plan(rng: np.random.Generator, layout: object) -> Plan:
    sites = ((0.0, 0.0), (0.002, 0.002), (-0.004, 0.001))
    presses = tuple(PlannedPress(u, v, 2.0 + i, 0.04, 0.3) for i, (u, v) in enumerate(sites))
    return Plan("short", presses, {"A": (0.0, 0.25, 0.83)})


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory) -> Seen:
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(collect_chain.PROTOCOLS, "paper", short_plan)
        return collect_chain.session("paper", 7, tmp_path_factory.mktemp("chain"))


def test_the_true_force_is_near_the_measured_one(seen: Seen):
    np.testing.assert_allclose(seen.true_force_n, seen.dataset.presses.force_n, rtol=0.06)
    record = reached(seen)
    assert record["presses"] == 3 and len(record["force_error_n"]) == 3
    assert np.abs(record["position_error_along_m"]).max() < 3e-3


def test_mean_contact_error_is_part_of_the_true_pose(seen: Seen):
    told = told_truth(seen, FitOptions())
    error = seen.dataset.presses.position_m[:, 1] - seen.true_point_m[:, 1]
    # On the way to the hold forces are smaller, and drives bend less.
    assert told["y_m"] - seen.truth["y_m"] == pytest.approx(error.mean(), abs=2e-4)
    assert told["y_m"] != seen.truth["y_m"] and told["beta_deg"] != seen.truth["beta_deg"]
    assert told["alpha_deg"] == seen.truth["alpha_deg"]
    share = told["scale_per_n as the forces tell it"] / seen.truth["scale_per_n"]
    assert share == pytest.approx(seen.true_force_n.sum() / seen.dataset.presses.force_n.sum())
    assert math.isclose(share, 1.0, abs_tol=0.06) and share != 1.0


def test_a_study_resumes_and_grows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(collect_chain.PROTOCOLS, "paper", short_plan)
    out = tmp_path / "chain.json"
    command = ["--protocol", "paper", "--workers", "1", "--out", str(out)]
    assert main([*command, "--seeds", "1"]) == 0
    first = json.loads(out.read_text())
    assert first["sessions"]["paper"]["presses"] == 3
    ran: list[int] = []
    monkeypatch.setattr(collect_chain, "run_job", lambda job: ran.append(job.seed) or run_job(job))
    assert main([*command, "--seeds", "2"]) == 0
    assert ran == [1] and json.loads(out.read_text())["sessions"]["paper"]["presses"] == 6
    assert main([*command, "--seeds", "1", "--fit"]) == 2


def test_a_session_that_fails_is_counted(monkeypatch: pytest.MonkeyPatch):
    far = Plan("far", (PlannedPress(0.03, 0.03, 2.0, 0.04, 0.3),), {"A": (0.0, 0.25, 0.83)})
    monkeypatch.setitem(collect_chain.PROTOCOLS, "paper", lambda rng, layout: far)
    record = run_job(Job("paper", 1, False, False))
    assert "press 0" in record["failed"]
    assert summary([record])["paper"] == {"sessions": 1, "failed": 1}
