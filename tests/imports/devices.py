"""Recordings as devices write them: taxels in one file, force and place in another, stamps of any kind."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

PLANE: dict[str, Any] = {
    "sensor": {"rows": 3, "cols": 3, "taxel_size_m": 0.003, "pitch_m": 0.004, "value_min": None, "value_max": None,
               "baseline": "raw"},
    "surface": {"kind": "plane", "radius_m": None},
    "indenter": {"kind": "sphere", "radius_m": 0.008},
    "mount": {"y_m": 0.0, "beta_deg": None, "beta_range_deg": None, "x_m": 0.0, "x_range_m": [-0.003, 0.003],
              "y_range_m": [-0.003, 0.003]},
    "position": {"sigma_m": 0.0005, "slack_m": 0.0012},
}  # fmt: skip
"""What differs from the rig of the other tests: a flat pad of 3 x 3 taxels."""

GRID_M = np.array([[0.004 * (c - 1), 0.004 * (r - 1)] for r in range(3) for c in range(3)])


@dataclass(frozen=True)
class Contacts:
    """Presses on the pad, and what each device sees of them.

    Attributes:
        start_s: of each press, shape (n,).
        lasts_s: of each.
        force_n: of each.
        place_m: of each, (n, 2); where it slides, it moves by ``slide_m`` along x in its hold, after a rest.
        slide_m: see there, (n,).
    """

    start_s: np.ndarray
    lasts_s: np.ndarray
    force_n: np.ndarray
    place_m: np.ndarray
    slide_m: np.ndarray

    @property
    def end_s(self) -> float:
        return float(self.start_s[-1] + self.lasts_s[-1] + 1.0)

    def force(self, time_s: np.ndarray) -> np.ndarray:
        return self._shares(time_s) @ self.force_n

    def place(self, time_s: np.ndarray) -> np.ndarray:
        """Return the indenter's place (m, 2), that of the current press or of the next."""
        now = np.minimum(np.searchsorted(self.start_s + self.lasts_s, time_s), len(self.start_s) - 1)
        moved = np.clip((time_s - self.start_s[now] - 0.7) / np.maximum(self.lasts_s[now] - 1.0, 0.1), 0, 1)
        place = self.place_m[now].copy()
        place[:, 0] += moved * self.slide_m[now]
        return place

    def images(self, time_s: np.ndarray, seed: int = 0) -> np.ndarray:
        """Whole counts of nine taxels that rest at 20, (m, 9)."""
        away = np.linalg.norm(self.place(time_s)[:, None] - GRID_M, axis=2)
        load = self.force(time_s)[:, None] * np.exp(-((away / 0.003) ** 2))
        return np.rint(20 + 40 * load + np.random.default_rng(seed).normal(0, 0.7, load.shape))

    def _shares(self, time_s: np.ndarray) -> np.ndarray:
        ramps = (time_s[:, None] - self.start_s) / 0.2, (self.start_s + self.lasts_s - time_s[:, None]) / 0.2
        return np.clip(np.minimum(*ramps), 0, 1)


def contacts(count: int = 12, seed: int = 1, *, slide_m: float = 0.0) -> Contacts:
    """Presses of different length, force and place, at uneven intervals."""
    rng = np.random.default_rng(seed)
    lasts, rest = rng.uniform(1.2, 2.0, count), rng.uniform(0.6, 1.6, count)
    starts = np.cumsum(lasts + rest) - lasts
    slides = np.where(np.arange(count) % 2 == 0, slide_m, 0.0)
    return Contacts(starts, lasts, rng.uniform(1, 4, count), rng.uniform(-0.004, 0.004, (count, 2)), slides)


def taxel_table(found: Contacts, time_s: np.ndarray) -> pd.DataFrame:
    """Columns ``s0`` to ``s8``; without stamps."""
    return pd.DataFrame(found.images(time_s).astype(int), columns=[f"s{j}" for j in range(9)])


def gauge_table(found: Contacts, time_s: np.ndarray) -> pd.DataFrame:
    """Columns ``F`` [N], ``px`` and ``py`` [mm]; without stamps."""
    place = 1e3 * found.place(time_s)
    noise = np.random.default_rng(5).normal(0, 0.003, len(time_s))
    return pd.DataFrame({"F": found.force(time_s) + noise, "px": place[:, 0], "py": place[:, 1]})


def whole_table(found: Contacts, time_s: np.ndarray) -> pd.DataFrame:
    """Columns ``t`` [s], and those of the gauge and of the taxels."""
    times = pd.DataFrame({"t": time_s})
    return pd.concat([times, gauge_table(found, time_s), taxel_table(found, time_s)], axis=1)


ONE_FILE: dict[str, Any] = {
    "csv": {"rows": "series"},
    "columns": {
        "time_s": {"column": "t", "unit": "s"},
        "force_n": {"column": "F", "unit": "N"},
        "x_m": {"column": "px", "unit": "mm"},
        "y_m": {"column": "py", "unit": "mm"},
        "z_m": {"value": 0.0, "unit": "m"},
    },
    "taxels": {"columns": "s{j}"},
    "series": {"on_n": 0.3, "off_n": 0.15},
}
"""A mapping of a table with everything in it."""

TWO_FILES: dict[str, Any] = {
    **ONE_FILE,
    "files": {"gauge": {"file": "gauge.csv", "time": {"column": "t", "unit": "s"}}},
    "columns": {
        "time_s": {"column": "t", "unit": "s"},
        "force_n": {"file": "gauge", "column": "F", "unit": "N"},
        "x_m": {"file": "gauge", "column": "px", "unit": "mm"},
        "y_m": {"file": "gauge", "column": "py", "unit": "mm"},
        "z_m": {"value": 0.0, "unit": "m"},
    },
}
"""A mapping of the taxels' table and that of a gauge."""
