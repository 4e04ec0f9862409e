"""The text of a diagnosis, for the terminal, a notebook and the page."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np

if TYPE_CHECKING:
    from skincal.diagnosis.diagnosis import Diagnosis, NamedEffect

Tone = Literal["good", "found", "attention"]


def tone(found: Diagnosis) -> Tone:
    """Return the tone that sets the colour of the verdict: nothing to do, something found, or something open."""
    if found.verdict == "none":
        return "good"
    return "found" if found.verdict == "effects" and not found.unexplained else "attention"


def headline(found: Diagnosis) -> str:
    """Return the verdict in one sentence."""
    return _words("headline", found)


def gap_sentence(found: Diagnosis) -> str:
    """Return the sentence about the gap on the test presses, without capital and full stop."""
    return _words("gap", found)


def verdict_lines(found: Diagnosis) -> list[str]:
    """Return the verdict and its evidence, line by line."""
    return _words("lines", found, _parameters).splitlines()


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
