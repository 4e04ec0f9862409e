"""The benchmark of the simulated hand runs, and what it finds is sound."""

from __future__ import annotations

import pytest

from benchmarks.sim_speed import errors, speed


def test_the_joints_tell_of_the_contact() -> None:
    found = errors(seeds=2, presses=2)
    assert found["holds"] == 4
    found = found["quantiles"]
    assert abs(found["force_error_relative"]["0.5"]) < 0.05
    assert found["position_error_m"]["0.95"] < 3e-3
    assert found["position_error_less_mean_m"]["0.95"] < found["position_error_m"]["0.95"]


@pytest.mark.slow
def test_a_session_takes_well_under_a_minute() -> None:
    # 400 s of a session, force and place found from every state.
    assert 400 * speed(2, joints=True)["processor_s_per_simulated_s"] < 60
