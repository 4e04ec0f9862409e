"""The notebooks: committed without outputs, and every assertion in them holds.

The documentation runs them too, in a kernel; here their cells run as plain Python, so that no kernel is needed.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import matplotlib as mpl
import pytest

NOTEBOOKS = Path(__file__).parent.parent / "notebooks"
FIRST, SECOND, THIRD = "01_skin_model.ipynb", "02_fit_and_valley.ipynb", "03_collect.ipynb"
FOURTH, FIFTH = "04_close_a_gap.ipynb", "05_train_and_evaluate.ipynb"
LONG = [pytest.param(name, marks=pytest.mark.slow) for name in (SECOND, THIRD, FOURTH, FIFTH)]


def cells(name: str) -> list[dict[str, Any]]:
    """The cells of code of a notebook."""
    content = json.loads((NOTEBOOKS / name).read_text(encoding="utf-8"))
    return [cell for cell in content["cells"] if cell["cell_type"] == "code"]


def test_all_notebooks_are_tested():
    assert sorted(path.name for path in NOTEBOOKS.glob("*.ipynb")) == [FIRST, SECOND, THIRD, FOURTH, FIFTH]


@pytest.mark.parametrize("name", [FIRST, SECOND, THIRD, FOURTH, FIFTH])
def test_notebook_has_no_outputs_and_asserts_its_values(name: str):
    found = cells(name)
    assert all(not cell["outputs"] and cell["execution_count"] is None for cell in found)
    assert sum("assert" in "".join(cell["source"]) for cell in found) >= 5


@pytest.mark.parametrize("name", [FIRST, *LONG])
def test_notebook_runs(name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    monkeypatch.chdir(NOTEBOOKS)
    mpl.use("agg")
    import matplotlib.pyplot as plt

    names: dict[str, Any] = {}
    with mpl.rc_context():
        for number, cell in enumerate(cells(name)):
            exec(compile("".join(cell["source"]), f"{name}, code cell {number}", "exec"), names)
            for figure in map(plt.figure, plt.get_fignums()):
                figure.canvas.draw()
            plt.close("all")
    assert capsys.readouterr().out
