"""The rig of all sessions: sizes of finger, sensor and indenters, and where the taxels are."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

FINGER_RADIUS_M = 0.0115
SPHERES_M = (0.006, 0.004)
ROWS = COLS = 4
TAXELS = ROWS * COLS
TAXEL_M, PITCH_M = 0.0025, 0.004
NOMINAL_Y_M = 0.0235
SIGMA_M, SLACK_M = 0.001, 0.002
RATE_HZ = 25.0
TOP_COUNTS = 255

_COLUMN = np.tile(np.arange(float(COLS)), ROWS)
_ROW = np.repeat(np.arange(float(ROWS)), COLS)
TAXEL_UV_M: Floats = np.column_stack([_COLUMN - (COLS - 1) / 2, _ROW - (ROWS - 1) / 2]) * PITCH_M
"""Centres of the taxels on the patch (J, 2) [m]; the flat index is row times columns plus column."""


def taxel_names() -> list[str]:
    """Columns of the taxels, in the order of the flat index."""
    return [f"taxel_{r}_{c}" for r in range(ROWS) for c in range(COLS)]


def centres_m(y_m: float, beta_deg: float, alpha_deg: float) -> Floats:
    """Return the taxels' centres: arc round the finger from ``beta = 0`` and place along it (J, 2) [m]."""
    turn = np.radians(alpha_deg)
    u, v = TAXEL_UV_M.T
    arc = np.radians(beta_deg) * FINGER_RADIUS_M + u * np.cos(turn) - v * np.sin(turn)
    return np.column_stack([arc, y_m + u * np.sin(turn) + v * np.cos(turn)])


def on_finger(arc_m: Floats, along_m: Floats) -> Floats:
    """Points (K, 3) [m] of the finger's surface."""
    angle = arc_m / FINGER_RADIUS_M
    return np.column_stack([FINGER_RADIUS_M * np.sin(angle), along_m, FINGER_RADIUS_M * np.cos(angle)])
