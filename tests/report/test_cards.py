"""Results show themselves: short in a terminal, as a card in a notebook."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import pytest
from diagnosis.diagnose_data import moving, still
from report.diagnosis_cases import LOOP, calibration

from skincal.calibration import Finding
from skincal.report.cards import card


def test_a_dataset_says_what_it_holds():
    assert repr(moving()) == f"<Dataset dataset: 16 presses, {len(moving().frames)} frames, 4 x 4 taxels>"  # type: ignore[arg-type]
    assert repr(still()) == "<Dataset dataset: 16 presses, no frames, 4 x 4 taxels>"
    shown = moving()._repr_html_()
    assert "16 presses" in shown and "4 × 4 taxels on a cylinder" in shown


def test_a_calibration_says_its_numbers_and_effects():
    plain, more = calibration(), calibration(LOOP)
    assert "elasticity_pa_per_m 4e+08" in repr(plain) and "no effects" in repr(plain)
    assert repr(more).endswith("; hysteresis>")
    shown = more._repr_html_()
    assert "hysteresis: height" in shown and "0.6" in shown


def test_a_card_escapes_what_comes_from_files():
    odd = replace(calibration(), findings=(Finding("misfit", "warning", "<b>1 < 2</b>"),))
    assert "&lt;b&gt;1 &lt; 2&lt;/b&gt;" in card(odd)


def test_what_is_no_result_has_no_card():
    with pytest.raises(TypeError, match="expected a result of skincal, got int"):
        card(3)


def test_results_are_made_without_the_report():
    made = "import sys, skincal.diagnosis.diagnosis, skincal.calibrate"
    code = f"{made}; print([m for m in sys.modules if 'report' in m])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert [m for m in eval(done.stdout) if m.startswith("skincal")] == []
