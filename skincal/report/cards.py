"""Results in words: the text of a diagnosis, and cards for notebooks, which are HTML without a picture."""

from __future__ import annotations

from collections.abc import Iterable
from functools import singledispatch
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from skincal.calibrate import Outcome, UniformOutcome
from skincal.calibration import Calibration
from skincal.dataset import Dataset
from skincal.diagnosis.diagnosis import Diagnosis
from skincal.inference.constants import LEVEL
from skincal.report.page import capital, macro, percent, rendered, span

if TYPE_CHECKING:
    from skincal.diagnosis.diagnosis import NamedEffect


Row = tuple[str, ...]


@singledispatch
def card(result: object) -> str:
    """Return a result as HTML; raise a TypeError for any other object."""
    raise TypeError(f"expected a result of skincal, got {type(result).__name__}")


@card.register
def _(result: Dataset) -> str:
    sensor, presses = result.meta.sensor, result.presses
    force = presses.force_n[np.isfinite(presses.force_n)]
    spread = f"{force.min():.3g} to {force.max():.3g} N" if len(force) else "unknown force"
    rows = [
        ("presses", f"{len(presses)}, {spread}"),
        ("frames", "none" if result.frames is None else str(len(result.frames))),
        ("sensor", f"{sensor.rows} × {sensor.cols} taxels on a {result.meta.surface}"),
        ("indenter", str(result.meta.indenter)),
    ]
    return _card(f"{result.folder.name if result.folder else 'dataset'}: {len(presses)} presses", rows)


@card.register
def _(result: Calibration) -> str:
    rows: list[Row] = [("", "best", "interval")]
    for name, value in result.model.best().items():
        low, high = result.intervals.get(name, (-np.inf, np.inf))
        interval = f"{low:.4g} to {high:.4g}" if np.isfinite(high - low) else "unknown"
        rows.append((name, f"{value:.4g}", interval))
    for effect in result.effects:
        rows += [
            (f"{effect.name}: {name}", span(value), _interval(value, *effect.intervals.get(name, ("", ""))))
            for name, value in effect.parameters.items()
        ]
    error = float(np.sqrt(result.loss.mse_counts2))
    effects = ", ".join(effect.name for effect in result.effects)
    kind = f"Calibration with {effects}" if effects else "Calibration"
    title = f"{kind}: {error:.3g} {result.sensor.unit_label} rms on {result.loss.presses_used} presses"
    return _card(title, rows, findings=result.findings)


@card.register(Outcome | UniformOutcome)
def _(result: Outcome | UniformOutcome) -> str:
    return card(result.calibration)


@card.register
def _(result: Diagnosis) -> str:
    rows: list[Row] = []
    for effect in result.effects:
        for name, (low, high) in effect.intervals.items():
            value = effect.parameters[name]
            rows.append((effect.name, name, span(value), _interval(value, low, high)))
    lines = [gap_sentence(result), *([result.where] if result.verdict == "unknown" else [])]
    head = [("effect", "parameter", "value", percent(LEVEL))] if rows else []
    return _card(headline(result), [*head, *rows], map(capital, lines), result.findings)


def _interval(value: Any, low: Any, high: Any) -> str:
    if isinstance(low, str):
        return ""
    return "one each" if np.ndim(value) else f"{span(low)} to {span(high)}"


def _card(title: str, rows: Iterable[Row], lines: Iterable[str] = (), findings: Iterable[object] = ()) -> str:
    return rendered("card.html", title=title, rows=list(rows), lines=lines, findings=findings)


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
