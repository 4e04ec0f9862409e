"""Calibrations made for tests: of the published result, on a cylinder, a plane and a mesh."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

import numpy as np
from published import META

from skincal.calibration import Calibration, Finding, Loss, ModelParameters, Provenance
from skincal.dataset import MountSpec, SurfaceSpec

INTERVALS = {
    "y_m": (0.02175, 0.02525),
    "beta_deg": (0.0, 5.03),
    "alpha_deg": (-15.0, 10.0),
    "elasticity_pa_per_m": (236e6, 848e6),
    "scale_per_n": (61.0, 76.0),
}
"""The published result (IROS 2024)."""


def make_calibration(rows: int = 200, **changes: Any) -> Calibration:
    """The published result as a calibration, with a cloud in which E rises with y."""
    rng = np.random.default_rng(0)
    y = rng.uniform(0.02175, 0.02525, rows)
    parts: dict[str, Any] = {
        **{name: getattr(META, name) for name in ("sensor", "surface", "indenter", "mount", "position")},
        "model": ModelParameters(0.0235, -3.0, 5.1e8, 68.0, beta_deg=2.1),
        "intervals": INTERVALS,
        "loss": Loss(9.1, 25.0, 24, {"noise_counts": 1.1}),
        "findings": (Finding("edge", "warning", "beta_deg ends at 0.", "Search from below 0."),),
        "provenance": Provenance(
            "ab" * 32,
            "paper",
            "0.1.0",
            "skincal fit paper --out cal",
            7,
            datetime(2026, 11, 21, 12, tzinfo=UTC),
            {"alpha_step_deg": 2.5, "workers": 2},
        ),
        "draws": {
            "y_m": y,
            "beta_deg": rng.uniform(0.0, 5.03, rows),
            "alpha_deg": rng.uniform(-15.0, 10.0, rows),
            "elasticity_pa_per_m": 236e6 + (y - 0.02175) / 0.0035 * 612e6,
            "scale_per_n": rng.uniform(61.0, 76.0, rows),
        },
        "grid": {"y_m": np.array([0.0235, 0.024]), "mse_counts2": np.array([9.5, np.nan])},
        "slack": make_slack(),
    }
    return Calibration(**(parts | changes))


def on_a_plane(**changes: Any) -> Calibration:
    """The same on a plane: x in place of beta."""
    intervals = {k: v for k, v in INTERVALS.items() if k != "beta_deg"} | {"x_m": (-0.001, 0.001)}
    mount = MountSpec(0.0235, 0.0, (0.0195, 0.0275), (-20.0, 20.0), x_m=0.0, x_range_m=(-0.004, 0.004))
    model = ModelParameters(0.0235, -3.0, 5.1e8, 68.0, x_m=0.0005)
    plane = {"surface": SurfaceSpec("plane"), "mount": mount, "model": model, "intervals": intervals}
    return make_calibration(**(plane | {"draws": None} | changes))


def make_slack() -> dict[str, Any]:
    """Three presses: a good one, a bad one, and one that was dropped."""
    nan = np.nan
    return {
        "press": np.array([0, 1, 5]),
        "used": np.array([True, True, False]),
        "reason": np.array(["", "", "one active taxel"], dtype=object),
        "x_m": np.array([0.0, 0.001, nan]),
        "y_m": np.array([0.023, 0.024, nan]),
        "z_m": np.array([0.0115, 0.0114, nan]),
        "slack_across_m": np.array([1e-4, -1.9e-3, nan]),
        "slack_along_m": np.array([-2e-4, 1.7e-3, nan]),
        "residual_rms_counts": np.array([1.1, 9.7, nan]),
        "good": np.array([True, False, False]),
    }
