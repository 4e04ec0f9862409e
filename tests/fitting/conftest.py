"""Sessions with a known truth, made with the skin model itself."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
from published import FINGER, LAYOUT
from published import RADIUS_M as RADIUS

from skincal.fitting.fit_options import FitOptions, GridSteps, SearchBox
from skincal.fitting.observe import Readout
from skincal.fitting.problem import PressTable, Rig
from skincal.model import Contacts, Converter, Patch, SensorPose, Skin, SkinParameters, Sphere


@dataclass(frozen=True)
class Truth:
    across_m: float = 0.4e-3
    y_m: float = 0.0238
    alpha_rad: float = math.radians(-5.0)
    elasticity_pa_per_m: float = 4e8
    scale_per_n: float = 68.0

    @property
    def macro(self) -> np.ndarray:
        logs = math.log(self.elasticity_pa_per_m), math.log(self.scale_per_n)
        return np.array([self.across_m, self.y_m, self.alpha_rad, *logs])


def rig(readout: Readout | None = None) -> Rig:
    readout = readout or Readout(0, 255, True)
    return Rig(LAYOUT, FINGER, (Sphere(0.006),), readout, 1e-3, 2e-3)


def skin(truth: Truth) -> Skin:
    pose = SensorPose(truth.y_m, truth.alpha_rad, truth.across_m / RADIUS)
    patch = Patch.build(FINGER, LAYOUT, pose)
    return Skin(patch, SkinParameters(truth.elasticity_pa_per_m, truth.scale_per_n), Converter.none())


def make_session(
    truth: Truth | None = None,
    *,
    presses: int = 45,
    seed: int = 0,
    position_sigma_m: float = 0.5e-3,
    noise: float = 1.0,
    frames: int = 25,
) -> tuple[PressTable, np.ndarray]:
    """A session of static presses and the true contact positions (K, 2)."""
    truth, rng = truth or Truth(), np.random.default_rng(seed)
    centre = np.array([truth.across_m, truth.y_m])
    where = centre + rng.uniform(-6.5e-3, 6.5e-3, (presses, 2))
    force = rng.uniform(1.0, 4.0, presses)
    beta = where[:, 0] / RADIUS
    points = np.stack([RADIUS * np.sin(beta), where[:, 1], RADIUS * np.cos(beta)], axis=1)
    values = skin(truth).values(Sphere(0.006), Contacts(points, FINGER.normal_at(points), force))
    noisy = values[:, None, :] + noise * rng.standard_normal((presses, frames, LAYOUT.taxels))
    counts = np.clip(np.rint(noisy), 0, 255).mean(axis=1) if noise > 0 else values
    error = np.clip(position_sigma_m * rng.standard_normal((presses, 2)), -1.8e-3, 1.8e-3)
    measured = where + error
    table = PressTable(
        np.arange(presses), measured[:, 0], measured[:, 1], force, counts, np.zeros(presses, dtype=np.intp)
    )
    return table, where


def some_presses(table: PressTable, rows: np.ndarray) -> PressTable:
    """Rows of a table."""
    names = ("press", "across_m", "along_m", "force_n", "counts", "indenter")
    return PressTable(*(getattr(table, name)[rows] for name in names))


BOX = SearchBox((-2.4e-3, 2.4e-3), (0.0205, 0.0265), (math.radians(-20), math.radians(20)))
QUICK = FitOptions(
    steps=GridSteps(1.2e-3, 1.0e-3, math.radians(10), 8),
    law_spreads_m=(0.0, 0.2e-3, 0.4e-3),
    rounds=(5, 8),
    round_size=200,
    enough_draws=150,
)

FEW_DRAWS = replace(QUICK, rounds=(3, 4), round_size=100, enough_draws=2)
"""For what needs no good interval: draws that are worth little do not start the ensemble of walkers."""

ONE_LAW = replace(QUICK, law_spreads_m=(0.0,))
ROUGH = replace(FEW_DRAWS, steps=GridSteps(2.0e-3, 2.0e-3, math.radians(20), 5), law_spreads_m=(0.0,))
"""For what asks nothing of other contact laws either, each of which is another climb, nor of a fine grid."""


@pytest.fixture(scope="session")
def truth() -> Truth:
    return Truth()
