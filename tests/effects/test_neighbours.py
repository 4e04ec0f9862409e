"""Neighbouring taxels are found by their positions."""

from __future__ import annotations

import numpy as np
import pytest

from skincal.effects.setting import Setting
from skincal.model import Patch, Plane, SensorPose, TaxelLayout


def neighbours(layout: TaxelLayout) -> np.ndarray:
    return Setting(Patch.build(Plane(), layout, SensorPose(0.0, 0.0), 1e-3), Plane()).neighbours


@pytest.mark.parametrize("pitch_m", [(4e-3, 4e-3), (3e-3, 5e-3)])
def test_in_a_grid_they_are_the_next_in_row_and_column(pitch_m: tuple[float, float]):
    near = neighbours(TaxelLayout.grid(3, 4, taxel_size_m=2.5e-3, pitch_m=pitch_m))
    row, col = np.divmod(np.arange(12), 4)
    apart = np.abs(row[:, None] - row) + np.abs(col[:, None] - col)
    assert (near == (apart == 1)).all()


def hexagonal(rows: int = 4, cols: int = 4, pitch_m: float = 4e-3) -> TaxelLayout:
    row, col = np.divmod(np.arange(rows * cols), cols)
    centres = np.stack([(col + 0.5 * (row % 2)) * pitch_m, row * pitch_m * np.sqrt(3) / 2], axis=1)
    return TaxelLayout(rows, cols, centres - centres.mean(axis=0), np.full((rows * cols, 2), 2.5e-3))


def test_in_a_hexagonal_layout_they_are_six():
    layout = hexagonal()
    near = neighbours(layout)
    apart = np.linalg.norm(layout.centres_m[:, None] - layout.centres_m, axis=-1)
    assert (near == ((apart > 0) & (apart < 4.1e-3))).all()
    assert near.sum(axis=1).max() == 6


def test_in_any_layout_they_are_mutual_and_reach_all():
    rng = np.random.default_rng(1)
    layout = hexagonal()
    moved = layout.centres_m + rng.uniform(-0.6e-3, 0.6e-3, (16, 2))
    near = neighbours(TaxelLayout(4, 4, moved, np.full((16, 2), 2e-3)))
    assert (near == near.T).all()
    assert (np.linalg.matrix_power(near + np.eye(16), 16) > 0).all()
