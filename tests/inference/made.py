"""Small made sessions for the engine: the presses of the diagnosis' tests, read by a converter at any level at rest."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import replace

import numpy as np
import pytest
from diagnosis.diagnose_data import moving, reading
from report.diagnosis_cases import calibration
from sharing import made_once

from skincal.dataset import Dataset
from skincal.diagnosis.diagnosis import Diagnosis
from skincal.diagnosis.workflow import diagnose
from skincal.effects import Samples
from skincal.model import Contacts, Indenter, Skin, Sphere
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
    bare: bool = False,
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
        bare: whether taxels feel the pressure itself.
    """
    given = moving(presses)
    skin = calibration(effects)  # type: ignore[arg-type]
    # A level below that at rest is read, too, where the converter has room for it.
    skin = replace(skin, sensor=replace(skin.sensor, value_min=-rest))
    with felt_bare() if bare else nullcontext():
        said = predict_dataset(skin, replace(given, meta=replace(given.meta, sensor=skin.sensor))).dataset
    assert said.frames is not None
    rng = np.random.default_rng(seed)
    counts = np.nan_to_num(said.frames.counts)
    if callable(change):
        counts = change(counts, said.frames.time_s)
    noise = np.hypot(1.0, grows * np.maximum(counts, 0.0)) * rng.standard_normal(counts.shape)
    counts = np.clip(step * np.rint((counts + rest + noise) / step), 0, 255 + rest)
    return reading(given, counts, value_max=255 + rest)


def bare_loads(skin: Skin, indenter: Indenter, contacts: Contacts) -> np.ndarray:
    """Loads (K, J) [N] of taxels that feel the pressure itself: those of points, without either projection."""
    assert isinstance(indenter, Sphere)
    felt, patch = skin.pressures(indenter, contacts), skin.patch
    out, ends = np.zeros((len(contacts), patch.layout.taxels)), felt.starts
    for k, (up, place) in enumerate(zip(contacts.normals, contacts.points_m, strict=True)):
        own = felt.points[ends[k] : ends[k + 1]]
        to = patch.points_m[own] - place
        aside = np.linalg.norm(to - (to @ up)[:, None] * up, axis=1)
        load = felt.load_n[ends[k] : ends[k + 1]] / np.sqrt(1 - (aside / indenter.radius_m) ** 2)
        on = patch.taxel[own] >= 0
        np.add.at(out[k], patch.taxel[own[on]], (load / (patch.normals[own] @ up))[on])
    return out


@contextmanager
def felt_bare() -> Iterator[None]:
    """Let taxels of all skins feel the pressure itself."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(
            Skin, "_loads", lambda skin, indenter, contacts, *_: bare_loads(skin, indenter, contacts)
        )
        yield


@made_once
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


DIES, FROM_S = 5, 103.0

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
    "gain_drift, in steps of 8": {
        "effects": {"gain_drift": {"rate_per_s": 0.9 / 186}},
        "rest": 27.4,
        "step": 8.0,
    },
    "dead_taxel, from a moment on": {
        "effects": {"dead_taxel": {"answer": 1.0 - np.eye(16)[DIES], "from_s": FROM_S * np.eye(16)[DIES]}},
        "rest": 30.0,
    },
    "taxel_gain": {
        "effects": {"taxel_gain": {"gain": np.exp(0.15 * np.random.default_rng(0).standard_normal(16))}},
        "rest": 30.0,
    },
    "nothing, pressure itself": {"rest": 40.0, "bare": True},
    "taxel_gain, pressure itself": {
        "effects": {"taxel_gain": {"gain": np.exp(0.15 * np.random.default_rng(1).standard_normal(16))}},
        "rest": 40.0,
        "bare": True,
    },
    "saturation, pressure itself": {
        "effects": {"saturation": {"inverse_ceiling_per_count": 1 / 70}},
        "rest": 40.0,
        "bare": True,
    },
    "wiring": {"change": swapped},
}

__all__ = ["DIES", "FROM_S", "KINDS", "Samples", "found", "made"]
