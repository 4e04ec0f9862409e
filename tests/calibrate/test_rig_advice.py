"""Advice names what the rig has."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.sessions import make_session
from skincal.calibrate.data_findings import adapt_to_rig, has_joints
from skincal.calibration import Finding

SCATTER = Finding("force_scatter", "warning", "Forces scatter.", "Check the torque sensors' zero.")


def test_a_stage_is_reported_of_its_load_cell() -> None:
    session = make_session(np.random.default_rng(1), presses=3)[0]
    columns = {name: c for name, c in session.presses.columns.items() if not name.startswith(("q_", "tau_"))}
    stage = replace(session, presses=replace(session.presses, columns=columns))
    hand = replace(stage, presses=replace(stage.presses, columns={**columns, "tau_0": np.zeros(3)}))
    assert not has_joints(stage)
    assert has_joints(hand)
    assert "load cell" in adapt_to_rig((SCATTER,), stage)[0].advice
    assert adapt_to_rig((SCATTER,), hand) == (SCATTER,)
