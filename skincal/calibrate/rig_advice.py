"""Findings in the words of the rig that took the data, and in the unit of its sensor."""

from __future__ import annotations

from dataclasses import replace

from skincal.calibration import Finding
from skincal.dataset import Dataset

ON_A_STAGE = {
    "force_scatter": "Check the zero of the load cell, and that it measures along the normal of the skin.",
    "positions_worse": "Check how the stage's axes lie to the sensor, and the offset of the indenter's tip; raise "
    "[position] sigma_m and slack_m.",
    "positions_bent": "Align the axes of the stage with the sensor's edges for a sharper alpha.",
}
"""Advice where there are no joints, by the code of the finding."""


def has_joints(dataset: Dataset) -> bool:
    """Return whether a hand took the data: its joints' angles or torques are there."""
    return any(dataset.presses.column(name) is not None for name in ("q_0", "tau_0"))


def for_the_rig(findings: tuple[Finding, ...], dataset: Dataset) -> tuple[Finding, ...]:
    """Return findings in the unit of the sensor, with advice that names what the rig of a dataset has."""
    findings = tuple(one.in_unit(dataset.meta.sensor.unit) for one in findings)
    if has_joints(dataset):
        return findings
    return tuple(replace(one, advice=ON_A_STAGE.get(one.code, one.advice)) for one in findings)
