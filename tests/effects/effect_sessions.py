"""Sessions and skins that the tests of effects share."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from published import FINGER, LAYOUT, presses_on

from skincal.effects import (
    COVARIATES,
    EFFECTS,
    EffectSkin,
    HoldSession,
    Samples,
    Steps,
    hold_session,
    hold_times,
)
from skincal.model import Patch, SensorPose, Skin, SkinParameters, Sphere

Floats = NDArray[np.float64]

PATCH = Patch.build(FINGER, LAYOUT, SensorPose(0.0235, 0.2, 0.05), resolution_m=0.7e-3)
SKIN = Skin(PATCH, SkinParameters(4e8, 70.0))
BASE = EffectSkin(SKIN, FINGER)


contacts_at = partial(presses_on, FINGER)
"""Contacts at arc lengths across and along from the middle of the patch [m], and forces [N]."""


def session(presses: int = 24, steps: Steps | None = None, seed: int = 3) -> HoldSession:
    """Presses all over the patch, with everything that effects may ask for, some minutes long."""
    rng = np.random.default_rng(seed)
    across, along = rng.uniform(-6e-3, 6e-3, (2, presses))
    shear = rng.normal(0.0, 0.5, (2, presses))
    holds = Samples.of(
        contacts_at(across, along, rng.uniform(0.5, 4.0, presses)),
        ((Sphere(0.006), Sphere(0.004)), rng.integers(0, 2, presses)),
        press=np.arange(presses),
        speed_m_per_s=rng.choice([2.5e-4, 2e-3], presses),
        cycle=rng.integers(0, 3, presses),
        met_n=rng.uniform(0.0, 4.0, presses),
        pose=rng.integers(0, 2, presses),
        temperature_c=25 + np.cumsum(rng.normal(0.0, 0.3, presses)),
        shear_u_n=shear[0],
        shear_v_n=shear[1],
    )
    start = 3.0 + 400.0 / presses * np.arange(presses)
    stay = np.where(rng.uniform(size=presses) < 0.5, 1.0, 5.0)
    loading = np.where(holds.speed_m_per_s > 1e-3, 0.3, 2.0)
    times = hold_times(presses, start, start + loading, start + loading + stay)
    return hold_session(holds, times, steps)


SESSION = session(steps=Steps(8, 6, 8)).samples
SHORT = session(6, Steps(5, 5, 5)).samples
VALUES = BASE.values(SESSION)


def skin_with(name: str, strength: float = 1.0, seed: int = 1, **parameters: object) -> EffectSkin:
    """The skin with one effect, of a strength or with given parameters."""
    given = parameters or EFFECTS[name].at_strength(strength, np.random.default_rng(seed), LAYOUT)
    return BASE.with_effects({name: given})


def shuffled(samples: Samples, covariate: str, seed: int = 9) -> Samples:
    """The same samples with other values of a covariate."""
    rng = np.random.default_rng(seed)
    attribute = COVARIATES[covariate].attribute
    if covariate == "time":
        steps = rng.permutation(np.diff(samples.time_s)) * rng.uniform(0.3, 3.0, len(samples) - 1)
        return replace(samples, time_s=np.concatenate([[1.0], 1.0 + np.cumsum(steps)]), start_s=np.nan)
    return replace(samples, **{attribute: rng.permutation(getattr(samples, attribute))})


def without(samples: Samples, *covariates: str) -> Samples:
    """The same samples as if covariates had not been recorded."""
    return replace(samples, **{COVARIATES[name].attribute: None for name in covariates})


def rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))
