"""A session diagnosed in this process, from the engine's own fit of the base model instead of ``skincal fit``.

A search for the pose on a grid takes minutes of a session whose diagnosis takes seconds, and a diagnosis needs no more
of a calibration than a place to begin.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from skincal.calibration import Calibration, Loss, ModelParameters, Provenance
from skincal.dataset import Dataset, read_dataset
from skincal.diagnosis.diagnosis import summary
from skincal.diagnosis.observed import observe
from skincal.diagnosis.workflow import diagnose
from skincal.inference.start import fit_base

Record = dict[str, Any]


def quick_calibration(dataset: Dataset) -> Calibration:
    """The base model as the engine fits it from the nominal pose; its intervals are none."""
    observed = observe(dataset, None, np.random.default_rng(0), keep=False)
    s, meta = fit_base(observed.fitter, start_is_calibrated=False).state, dataset.meta
    model = ModelParameters(
        s.pose.y_m, float(np.degrees(s.pose.alpha_rad)), float(np.exp(s.log_e)), float(np.exp(s.log_s)),
        beta_deg=float(np.degrees(s.pose.beta_rad)),
    )  # fmt: skip
    return Calibration(
        sensor=meta.sensor, surface=meta.surface, indenter=meta.indenter, model=model,
        intervals={name: (value, value) for name, value in model.best().items()},
        loss=Loss(1.0, 1.0, len(dataset.presses), {}), mount=meta.mount, position=meta.position,
        provenance=Provenance(
            dataset.sha256 or "0" * 64, "", "", "benchmarks.blind.quick", 0, datetime(2000, 1, 1, tzinfo=UTC), {}
        ),
    )  # fmt: skip


def diagnosed(folder: Path, plain: Callable[[Any], Any]) -> Record:
    """What ``fit`` and ``diagnose`` are in the record of a session.

    Args:
        folder: the dataset.
        plain: makes values that JSON has.
    """
    dataset = read_dataset(folder)
    calibration, fit = _timed(lambda: quick_calibration(dataset))
    if calibration is None:
        return {"fit": fit}
    found, done = _timed(lambda: diagnose(dataset, calibration))
    if found is not None:
        done["json"] = plain(summary(found))
        done["calibrated"] = calibrated(found.calibration)
    return {"fit": fit, "diagnose": done}


def calibrated(calibration: Calibration) -> Record:
    """Best value, low and high end of each parameter."""
    best, ends = calibration.model.best(), calibration.intervals
    return {k: [best[k], *map(float, ends[k])] for k in best}


def _timed(work: Callable[[], Any]) -> tuple[Any, Record]:
    start, wall = time.process_time(), time.perf_counter()
    try:
        found, status = work(), {"status": 0}
    except Exception as error:  # whatever fails is a failed session, as a command's would be
        found, status = None, {"status": 1, "messages": repr(error)}
    times = {"wall_s": round(time.perf_counter() - wall, 2), "cpu_s": round(time.process_time() - start, 2)}
    return found, status | times
