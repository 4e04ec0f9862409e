"""The text of a diagnosis, for the terminal, a notebook and the report."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np

if TYPE_CHECKING:
    from skincal.diagnosis.diagnosis import Diagnosis, NamedEffect

Tone = Literal["good", "found", "attention"]


def tone(diagnosis: Diagnosis) -> Tone:
    """Return the tone, which sets the colour of the verdict: nothing to do, effects found, or something unexplained."""
    if diagnosis.verdict == "none":
        return "good"
    return "found" if diagnosis.verdict == "effects" and not diagnosis.unexplained else "attention"


def headline(diagnosis: Diagnosis) -> str:
    """Return the verdict in one sentence."""
    return _words("headline", diagnosis)


def gap_sentence(diagnosis: Diagnosis) -> str:
    """Return the sentence about the gap on the test presses, without capital and full stop."""
    return _words("gap", diagnosis)


def verdict_lines(diagnosis: Diagnosis) -> list[str]:
    """Return the verdict and its evidence, line by line."""
    return _words("lines", diagnosis, _parameters).splitlines()


def _words(name: str, *values: object) -> str:
    from skincal.report.page import macro

    return macro("diagnosis_words.txt", name, *values)


def _parameters(effect: NamedEffect) -> list[str]:
    """Return the fitted parameters of an effect that have an interval, or differ between taxels."""
    lines: list[str] = []
    for name, (low, high) in effect.intervals.items():
        array = np.asarray(effect.parameters[name])
        if array.ndim == 0 and low < high:
            lines.append(f"{name} {float(array):.4g} ({float(low):.4g} to {float(high):.4g})")
        elif array.ndim and (array != array[0]).any():
            lines.append(
                f"{name} {len(array)} values, {float(np.min(array)):.3g} to {float(np.max(array)):.3g}"
            )
    return lines
