"""Small sessions with something hidden, and diagnoses of them, for the tests of the report and of the verb."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from math import degrees
from typing import Any

import numpy as np
from calibrations import make_calibration
from diagnosis.diagnose_data import moving, reading
from sharing import made_once

from skincal.calibration import Calibration, Effect, ModelParameters
from skincal.dataset import Dataset
from skincal.diagnosis.diagnosis import Diagnosis
from skincal.diagnosis.workflow import diagnose, refitted_effects
from skincal.prediction import predict_dataset

TRUTH = ModelParameters(0.0235, degrees(0.05), 4e8, 70.0, beta_deg=degrees(0.2))
LOOP = {"hysteresis": {"height": 0.6, "width": 1.5}}


def calibration(effects: Mapping[str, Mapping[str, float]] | None = None) -> Calibration:
    """A calibration of the sessions below, with effects or without."""
    known = {name: (value, value) for name, value in TRUTH.best().items()}
    added = tuple(Effect(name, dict(parameters)) for name, parameters in (effects or {}).items())
    return make_calibration(model=TRUTH, intervals=known, draws=None, grid=None, findings=(), effects=added)


def session(
    effects: Mapping[str, Mapping[str, float]] | None = None, presses: int = 24, seed: int = 5
) -> Dataset:
    """A session with frames, as a skin with these effects answers."""
    given = moving(presses)
    said = predict_dataset(calibration(effects), given).dataset
    assert said.frames is not None
    return reading(given, _read(said.frames.counts, np.random.default_rng(seed)))


def _read(values: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return np.clip(np.round(values + rng.normal(size=values.shape)), 0, 255)


def without_frames(data: Dataset) -> Dataset:
    """The hold means of a session, and nothing else."""
    return replace(data, frames=None, presses=replace(data.presses, columns={}))


START = {"hysteresis": {"height": 0.25, "width": 0.8}}
"""Where refits of the loop begin."""


def refitted(data: Dataset) -> Calibration:
    """The loop fitted again to a session."""
    return refitted_effects(data, calibration(), calibration(START))


@made_once
def refitted_loop() -> Calibration:
    """The loop fitted again to the session that has it."""
    return refitted(session(LOOP))


@made_once
def diagnosed(kind: str) -> tuple[Diagnosis, Dataset]:
    """``hysteresis``: one effect hidden; ``static``: nothing, hold means only."""
    data = session(LOOP if kind == "hysteresis" else None, presses=16)
    data = without_frames(data) if kind == "static" else data
    return diagnose_quickly(data), data


def diagnose_quickly(data: Dataset, **options: Any) -> Diagnosis:
    """Diagnose against a null of few sessions."""
    return diagnose(data, calibration(), seed=1, null_sessions=40, **options)
