from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import pytest
from matplotlib.figure import Figure

from skincal.report.style import new_figure, png_bytes, save, style


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
