"""Findings about the data of a fit: of the dataset's own check, of the taxel order, of a moving rest level."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import isinf

import numpy as np
import pytest
from inference.made import made
from report.diagnosis_cases import calibration

from benchmarks.sessions import make_session
from skincal.calibrate import fit_problem
from skincal.calibrate.data_findings import (
    adapt_to_rig,
    has_joints,
    search_for_order,
    with_findings_of_check,
    with_moving_rest,
)
from skincal.calibration import Finding
from skincal.cli.demo import sample_path
from skincal.dataset import IDLE, Dataset, read_dataset
from skincal.dataset.rest import rest_drift
from skincal.errors import Problem
from skincal.fitting.fit_options import FitOptions
from tests.calibrations import make_calibration

DEAD = Finding("dead_taxel", "warning", "Taxel (0, 1) does not answer.", "Check its wiring.")
SCATTER = Finding("force_scatter", "warning", "Forces scatter.", "Check the torque sensors' zero.")
Session = Callable[..., Dataset]
EACH, IDLE_FRAMES, HELD = 8, 20, 10


@pytest.mark.parametrize(
    ("code", "told"), [("counter_wrapped", False), ("bytes_swapped", False), ("unit_suspect", True)]
)
def test_findings_of_check_stand_in_the_calibration(code: str, told: bool):
    problem = Problem(
        "presses.csv", "this", "that", "Mend it.", code, details={"mapping": "m", "factor": 2.0}
    )
    note = replace(problem, severity="note")
    data = replace(read_dataset(sample_path("paper-like")), warnings=(problem, note, Problem("a", "b", "c")))
    before = replace(calibration(), findings=(DEAD,))
    found = with_findings_of_check(before, data)
    first = Finding(code, "warning", "presses.csv: expected this; got that.", "Mend it.", "m", 2.0)
    assert found.findings == ((first, DEAD) if told else (first,))
    assert all(isinf(low) != told for low, _ in found.intervals.values())
    assert found.findings[0].as_json()["factor"] == 2.0 and "factor" not in DEAD.plain()


@pytest.mark.parametrize("stretch", [(0.9, 0.9), (1.1, 1.0)])
def test_stretched_positions_are_no_order(stretch: tuple[float, float]):
    data = made(presses=40, rest=40.0)
    beta, y = np.arctan2(data.presses.position_m[:, 0], data.presses.position_m[:, 2]), data.meta.mount.y_m
    radius = data.meta.surface.radius_m
    assert radius is not None
    beta, along = stretch[0] * beta, y + stretch[1] * (data.presses.position_m[:, 1] - y)
    places = np.column_stack([radius * np.sin(beta), along, radius * np.cos(beta)])
    assert search_for_order(replace(data, presses=replace(data.presses, position_m=places)))() is None


def test_a_stage_is_reported_of_its_load_cell() -> None:
    session = make_session(np.random.default_rng(1), presses=3)[0]
    columns = {name: c for name, c in session.presses.columns.items() if not name.startswith(("q_", "tau_"))}
    stage = replace(session, presses=replace(session.presses, columns=columns))
    hand = replace(stage, presses=replace(stage.presses, columns={**columns, "tau_0": np.zeros(3)}))
    assert not has_joints(stage)
    assert has_joints(hand)
    assert "load cell" in adapt_to_rig((SCATTER,), stage)[0].advice
    assert adapt_to_rig((SCATTER,), hand) == (SCATTER,)


def drifting(dataset: Dataset, drift: np.ndarray, noise: float = 0.5) -> Dataset:
    """The presses of a session with frames at rest before each, and levels (K,) that are added to both."""
    rng = np.random.default_rng(2)
    presses, frames = dataset.presses, dataset.frames
    assert frames is not None
    count, taxels = presses.counts.shape
    press = np.repeat(presses.press, IDLE_FRAMES + HELD)
    phase = np.tile(np.repeat([IDLE, 2], [IDLE_FRAMES, HELD]), count).astype(np.int8)
    image = np.where((phase == IDLE)[:, None], 0.0, np.repeat(presses.counts, IDLE_FRAMES + HELD, axis=0))
    counts = image + 40.0 + np.repeat(drift, IDLE_FRAMES + HELD)[:, None]
    counts = counts + noise * rng.standard_normal(counts.shape)
    touched = phase != IDLE
    place = np.where(touched[:, None], np.repeat(presses.position_m, IDLE_FRAMES + HELD, axis=0), np.nan)
    force = np.where(touched, np.repeat(presses.force_n, IDLE_FRAMES + HELD), 0.0)
    made = replace(
        frames,
        press=np.where(touched, press, -1),
        phase=phase,
        time_s=0.02 * np.arange(len(press)),
        force_n=force,
        position_m=place,
        counts=counts,
        columns={},
    )
    held = counts.reshape(count, IDLE_FRAMES + HELD, taxels)[:, IDLE_FRAMES:].mean(axis=1)
    sensor = replace(dataset.meta.sensor, integer=False, value_min=None, value_max=None)
    return replace(
        dataset,
        meta=replace(dataset.meta, sensor=sensor),
        presses=replace(presses, counts=held, columns={}),
        frames=made,
    )


def test_drift_with_rezeroing_is_taken_off(session: Session) -> None:
    """A driver that takes the level off again and again, and a skin that drifts by twelve counts between."""
    still = session(40)
    drift = 12.0 * (np.arange(40) % EACH) / EACH
    moving = drifting(still, drift)
    shifts = rest_drift(moving)
    assert shifts is not None
    assert shifts == pytest.approx(np.repeat((drift - drift.mean())[:, None], 16, axis=1), abs=0.5)
    seen, plain = (fit_problem(d, FitOptions()) for d in (moving, drifting(still, 0.0 * drift)))
    both = np.intersect1d(seen.rows, plain.rows)
    a, b = (p.values[np.isin(p.rows, both)] for p in (seen, plain))
    assert len(both) > 10
    assert np.nanstd(a - b) < 0.3


def test_nothing_is_taken_off_where_nothing_drifts(session: Session) -> None:
    shifts = rest_drift(drifting(session(40), np.zeros(40)))
    assert shifts is not None
    assert shifts.std() < 0.03


def test_clipped_levels_are_left_alone(session: Session) -> None:
    dataset = session(40)
    assert rest_drift(session(12, frames_per_press=0)) is None
    moving = drifting(dataset, np.linspace(0.0, 5.0, 40))
    assert moving.frames is not None
    sensor = replace(moving.meta.sensor, value_min=40.0)
    clipped = replace(
        moving,
        meta=replace(moving.meta, sensor=sensor),
        frames=replace(moving.frames, counts=np.maximum(moving.frames.counts, 40.0)),
    )
    shifts = rest_drift(clipped)
    assert shifts is not None
    assert not shifts.any()


def test_a_level_that_moves_is_reported(session: Session) -> None:
    drift = 12.0 * (np.arange(40) % EACH) / EACH
    calibration = make_calibration()
    before = len(calibration.findings)
    told = with_moving_rest(calibration, drifting(session(40), drift)).findings[before:]
    assert [(one.code, one.severity) for one in told] == [("rest_moves", "info")]
    assert "re-zeroing" in told[0].text
    assert len(with_moving_rest(calibration, drifting(session(40), 0.0 * drift)).findings) == before
