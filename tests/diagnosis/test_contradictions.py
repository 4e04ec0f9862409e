"""What a diagnosis may not say beside the fit of the same data."""

from __future__ import annotations

from dataclasses import replace

from report.diagnosis_cases import calibration, session, without_frames

from skincal.calibration import Finding
from skincal.diagnosis import workflow


def test_something_is_missing_where_the_fit_says_so() -> None:
    found = Finding("misfit", "warning", "images differ by twenty times the noise", "")
    fitted = replace(calibration(), findings=(found,))
    fitted = replace(fitted, provenance=replace(fitted.provenance, dataset_sha256=""))
    diagnosis = workflow.diagnose(without_frames(session(presses=16)), fitted, seed=1, null_sessions=2)
    assert diagnosis.verdict == "unknown"
    assert diagnosis.unexplained
    # Another session's misfit is not this one's.
    assert not workflow._misfits(
        replace(fitted, provenance=replace(fitted.provenance, dataset_sha256="a")), session()
    )
