"""Texts about taxel values in the unit of the sensor."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from markupsafe import escape

from skincal.calibration import Finding
from skincal.report.page import picture, rendered
from skincal.report.style import new_figure, style
from skincal.units import in_unit


@pytest.mark.parametrize(
    ("text", "unit", "shown"),
    [
        ("differ by 0.3 counts rms", "V", "differ by 0.3 V rms"),
        (
            "rmse [counts], density [1/count], 4 counts², 60 counts/N",
            "mT",
            "rmse [mT], density [1/mT], 4 mT², 60 mT/N",
        ),
        (
            "lower --active-counts; noise_counts, discounts",
            "V",
            "lower --active-counts; noise_counts, discounts",
        ),
        ("presses count; 5 counts", "\\g<0>", "presses count; 5 \\g<0>"),
        ("5 counts", None, "5 counts"),
    ],
)
def test_unit_replaces_counts(text: str, unit: str | None, shown: str):
    assert in_unit(text, unit) == shown


def test_findings_figures_and_pages_have_the_unit(tmp_path: Path):
    found = Finding("misfit", "warning", "Images differ by 0.02 counts.", "Below 0.01 counts?").in_unit("V")
    assert (found.text, found.advice) == ("Images differ by 0.02 V.", "Below 0.01 V?")
    with style():
        figure = new_figure(3, 2, "Values [counts]")
        axes = figure.add_subplot()
        axes.plot(np.arange(3), label="2 counts")
        axes.set(xlabel="simulated [counts]", ylabel="count")
        axes.legend()
    shown = picture(figure, "answers", tmp_path, "V")
    assert shown.file == "answers.png"
    assert axes.get_xlabel() == "simulated [V]" and axes.get_ylabel() == "count"
    assert axes.get_legend().get_texts()[0].get_text() == "2 V"
    head = {"tone": "", "source": escape("counts"), "headline": "a gap of 3 counts", "verdict": ""}
    page = rendered("verdict.html", "V", findings=(found,), **head)
    assert (
        "a gap of 3 V" in page and '<p class="sub">counts</p>' in page and "Images differ by 0.02 V." in page
    )
