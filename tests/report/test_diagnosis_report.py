"""The report of a diagnosis: its page, its pictures, and what it says."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from report.diagnosis_cases import diagnosed

from skincal.cli.terminal import plain
from skincal.diagnosis.diagnosis import summary
from skincal.report.cards import headline, tone, verdict_lines
from skincal.report.diagnosis import FIGURES, write_diagnosis_report


@pytest.mark.parametrize("kind", ["hysteresis", "static"])
def test_the_page_holds_its_pictures_and_the_verdict(kind: str, tmp_path: Path):
    found, data = diagnosed(kind)
    told = plain(summary(found))
    write_diagnosis_report(found, data, tmp_path, told)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert headline(found) in page
    said = {"hysteresis": ("refitted to all presses",), "static": ("are required", "no frames")}
    assert all(words in page for words in said[kind])
    assert {f"{stem}.png" for stem in (*FIGURES, "audit")} <= {p.name for p in tmp_path.iterdir()}
    assert json.loads((tmp_path / "diagnosis.json").read_text(encoding="utf-8")) == told
    json.dumps(told, allow_nan=False)


def test_what_was_named_is_said_with_its_numbers():
    found, _ = diagnosed("hysteresis")
    lines = "\n".join(verdict_lines(found))
    assert lines.startswith("Missing: hysteresis")
    assert "height" in lines and "% of the gap is closed" in lines
    assert tone(found) in ("found", "attention")
    # Its card says the same.
    assert repr(found).startswith("<Diagnosis effects: hysteresis, ")
    shown = found._repr_html_()
    assert headline(found) in shown and "height" in shown


def test_nothing_is_said_with_what_did_best():
    found, _ = diagnosed("static")
    assert tone(found) == "good"
    assert verdict_lines(found)[0] == "These presses show no missing effect."


def test_other_programs_find_the_keys_that_they_know():
    told = plain(summary(diagnosed("hysteresis")[0]))
    assert {"verdict", "effects", "unexplained", "cannot_see", "gap", "next_presses", "findings"} <= set(told)
    (effect,) = told["effects"]
    assert {"name", "consistent_with", "p_value", "parameters", "where"} <= set(effect)
    gap = told["gap"]
    assert {"heldout_rmse_before", "heldout_rmse_after", "noise_floor_rmse", "closed"} <= set(gap)
    above = [
        gap[k] ** 2 - gap["noise_floor_rmse"] ** 2 for k in ("heldout_rmse_before", "heldout_rmse_after")
    ]
    assert gap["closed"] == pytest.approx(1 - above[1] / above[0], abs=1e-6)
