"""Small made sessions for the engine: the presses of the diagnosis' tests, read by a converter at any level at rest."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache

import numpy as np
from diagnosis.diagnose_data import moving
from report.diagnosis_cases import calibration

from skincal.dataset import HOLD, Dataset, Presses
from skincal.diagnosis.diagnosis import Diagnosis
from skincal.diagnosis.workflow import diagnose
from skincal.effects import Samples
from skincal.prediction import predict_dataset

Given = Mapping[str, Mapping[str, object]]


def made(
    effects: Given | None = None,
    *,
    presses: int = 24,
    seed: int = 5,
    rest: float = 0.0,
    step: float = 1.0,
    grows: float = 0.0,
    change: object = None,
) -> Dataset:
    """A session of frames as a skin with these effects answers.

    Args:
        effects: hidden, parameters by name.
        presses: how many.
        seed: of the noise.
        rest: level at rest [counts]; above a few nothing clips.
        step: of the converter [counts].
        grows: part of the signal that is added to the noise.
        change: called with counts (M, J) and times (M,), for what no effect does.
    """
    given = moving(presses)
    said = predict_dataset(calibration(effects), given).dataset  # type: ignore[arg-type]
    assert said.frames is not None
    rng = np.random.default_rng(seed)
    counts = np.nan_to_num(said.frames.counts)
    if callable(change):
        counts = change(counts, said.frames.time_s)
    noise = np.hypot(1.0, grows * np.maximum(counts, 0.0)) * rng.standard_normal(counts.shape)
    counts = np.clip(step * np.rint((counts + rest + noise) / step), 0, 255 + rest)
    frames = replace(said.frames, counts=counts)
    held = [counts[(frames.press == p) & (frames.phase == HOLD)].mean(axis=0) for p in given.presses.press]
    table = Presses(
        given.presses.press, given.presses.position_m, given.presses.force_n, np.array(held),
        columns=given.presses.columns,
    )  # fmt: skip
    meta = replace(given.meta, sensor=replace(given.meta.sensor, value_max=255 + rest))
    return replace(given, meta=meta, presses=table, frames=frames)


@cache
def found(kind: str) -> Diagnosis:
    """The diagnosis of a kind of session."""
    data = made(**KINDS[kind])  # type: ignore[arg-type]
    cal = replace(calibration(), sensor=data.meta.sensor)
    return diagnose(data, cal, seed=1)


def swapped(counts: np.ndarray, time_s: np.ndarray) -> np.ndarray:
    """Two taxels exchanged: a fault of the wiring."""
    del time_s
    out = counts.copy()
    out[:, [5, 10]] = counts[:, [10, 5]]
    out[:, [6, 9]] = counts[:, [9, 6]]
    return out


KINDS: Mapping[str, Mapping[str, object]] = {
    "nothing": {},
    "nothing, resting at 40": {"rest": 40.0},
    "nothing, in steps of 4": {"rest": 25.0, "step": 4.0},
    "nothing, in steps of 8": {"rest": 27.4, "step": 8.0},
    "nothing, noise grows": {"rest": 40.0, "grows": 0.03},
    "hysteresis": {"effects": {"hysteresis": {"height": 0.5, "width": 1.5}}},
    "creep": {"effects": {"creep": {"amplitude": 0.25, "time_constant_s": 1.0}}},
    "crosstalk": {"effects": {"crosstalk": {"leak": 0.06}}, "rest": 40.0},
    "saturation": {"effects": {"saturation": {"inverse_ceiling_per_count": 1 / 120}}},
    "taxel_gain": {
        "effects": {"taxel_gain": {"gain": np.exp(0.15 * np.random.default_rng(0).standard_normal(16))}},
        "rest": 30.0,
    },
    "wiring": {"change": swapped},
}

__all__ = ["KINDS", "Samples", "found", "made"]
