"""Findings of a diagnosis that stand beside its verdict."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from inference.made import made
from report.diagnosis_cases import calibration

from skincal.dataset import Dataset
from skincal.diagnosis.observed import observe
from skincal.diagnosis.session_findings import _glitches
from skincal.inference.start import base_fit


def told(data: Dataset) -> list[str]:
    """What is said of single presses."""
    observed = observe(data, replace(calibration(), sensor=data.meta.sensor), np.random.default_rng(0))
    base = base_fit(observed.fitter, known=True)
    return [f"{one.code}: {one.text}" for one in _glitches(observed, base, base)]


def test_a_press_that_is_off_at_one_taxel_is_told():
    """Its other taxels are dark, so that over all of them it is like the others."""
    data = made(rest=40.0)
    assert data.frames is not None
    seed = np.random.default_rng(0)
    held = observe(data, replace(calibration(), sensor=data.meta.sensor), seed).held
    row = int(np.flatnonzero(~held)[8])
    number = data.presses.press[row]
    lit = int(data.presses.counts[row].argmax())
    counts = data.frames.counts.copy()
    counts[data.frames.press == number, lit] = 40.0
    assert not told(data)
    (text,) = told(replace(data, frames=replace(data.frames, counts=counts)))
    assert text.startswith("far_readings") and f"press {number}: " in text
