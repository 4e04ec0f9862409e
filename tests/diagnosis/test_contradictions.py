"""The verdict agrees with the fit of the same data and with the test presses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from report.diagnosis_cases import calibration, diagnose_quickly, diagnosed, session, without_frames

from skincal.calibration import Finding
from skincal.diagnosis import workflow


def test_misfit_of_the_fit_gives_unknown() -> None:
    misfit = Finding("misfit", "warning", "images differ by twenty times the noise", "")
    fitted = replace(calibration(), findings=(misfit,))
    fitted = replace(fitted, provenance=replace(fitted.provenance, dataset_sha256=""))
    diagnosis = workflow.diagnose(without_frames(session(presses=16)), fitted, seed=1, null_sessions=2)
    assert diagnosis.verdict == "unknown"
    assert diagnosis.unexplained
    # The misfit of another session does not count.
    assert not workflow._has_misfit(
        replace(fitted, provenance=replace(fitted.provenance, dataset_sha256="a")), session()
    )


def test_effect_is_withdrawn_if_most_of_the_gap_remains() -> None:
    plain, data = diagnosed("hysteresis")
    assert not plain.gap.is_unexplained
    frames, rng = data.frames, np.random.default_rng(0)
    assert frames is not None
    counts = frames.counts.copy()
    for row in plain.gap.presses:
        own = frames.press == data.presses.press[row]
        counts[own] += 3 * rng.integers(0, 2, counts.shape[1])
    diagnosis = diagnose_quickly(replace(data, frames=replace(frames, counts=counts)))
    assert (diagnosis.verdict, diagnosis.taken_back) == ("unknown", ("hysteresis",))
    assert diagnosis.gap.is_unexplained and not diagnosis.gap.is_refuted
