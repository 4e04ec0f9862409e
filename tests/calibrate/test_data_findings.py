"""What the check of a dataset says stands in its calibration; of corrupted values nothing is told."""

from __future__ import annotations

from dataclasses import replace
from math import isinf

import numpy as np
import pytest
from inference.made import made
from report.diagnosis_cases import calibration

from skincal.calibrate.data_findings import search_for_order, with_findings_of_check
from skincal.calibration import Finding
from skincal.cli.demo import sample_path
from skincal.dataset import read_dataset
from skincal.errors import Problem

DEAD = Finding("dead_taxel", "warning", "Taxel (0, 1) does not answer.", "Check its wiring.")


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
