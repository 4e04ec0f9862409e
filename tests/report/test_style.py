"""The style of figures, and maps with a value per taxel."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from skincal.model import TaxelLayout
from skincal.report.style import DIVERGING, draw_taxels, new_figure, png_bytes, save, style


@pytest.mark.parametrize(
    ("colours", "white"), [("viridis", [0, 1]), ("viridis_r", [2, 3]), (DIVERGING, [0, 3])]
)
def test_values_are_white_on_dark_colours_alone(colours: str, white: list[int]) -> None:
    axes = new_figure(3, 3).subplots()
    layout, values = TaxelLayout.grid(2, 2, taxel_size_m=2e-3, pitch_m=3e-3), np.array([0.0, 1.0, 3.0, 4.0])
    draw_taxels(axes, layout, values, Normalize(0.0, 4.0), colours)
    assert [k for k, text in enumerate(axes.texts) if text.get_color() == "white"] == white


def _title(figure: Figure) -> str:
    assert figure._suptitle is not None
    return figure._suptitle.get_text()


@pytest.mark.parametrize("name", ["数据", "プレス 3", "δοκιμή", "a$b_{$ 5%", "\\frac", "🙂", "two\nlines"])
def test_a_title_of_any_letters_is_drawn_without_a_warning(tmp_path: Path, name: str) -> None:
    with style():
        figure = new_figure(3, 2, f"{name}: 60 presses")
    # Warnings are errors here; fonts that lack a letter would warn, and a formula that does not end would raise.
    assert png_bytes(figure).startswith(b"\x89PNG")
    save(figure, tmp_path / "figure.svg")
    assert _title(figure).endswith(": 60 presses")


def test_letters_that_a_font_lacks_become_boxes() -> None:
    with style():
        assert _title(new_figure(3, 2, "Größe δ µ ß ± 5 €")) == "Größe δ µ ß ± 5 €"
        # A private letter, which no font that we name has.
        assert _title(new_figure(3, 2, "a\ue123b")) == "a□b"


def test_settings_of_the_working_folder_do_not_matter() -> None:
    """A ``matplotlibrc`` may come with a dataset; ``usetex`` would run a program."""
    with style():
        plain = png_bytes(new_figure(3, 2, "as it is"))
    with mpl.rc_context({"text.usetex": True, "figure.facecolor": "red", "savefig.facecolor": "red"}):
        with style():
            figure = new_figure(3, 2, "as it is")
        assert png_bytes(figure) == plain
