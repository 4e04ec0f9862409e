"""Maps with a value per taxel."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.colors import Normalize

from skincal.model import TaxelLayout
from skincal.report.style import DIVERGING, new_figure
from skincal.report.taxel_map import draw_taxels


@pytest.mark.parametrize(
    ("colours", "white"), [("viridis", [0, 1]), ("viridis_r", [2, 3]), (DIVERGING, [0, 3])]
)
def test_values_are_white_on_dark_colours_alone(colours: str, white: list[int]) -> None:
    axes = new_figure(3, 3).subplots()
    layout, values = TaxelLayout.grid(2, 2, taxel_size_m=2e-3, pitch_m=3e-3), np.array([0.0, 1.0, 3.0, 4.0])
    draw_taxels(axes, layout, values, Normalize(0.0, 4.0), colours)
    assert [k for k, text in enumerate(axes.texts) if text.get_color() == "white"] == white
