"""Cards of results for notebooks: a few lines and a small table, as HTML, without a picture."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import singledispatch
from html import escape

import numpy as np

from skincal.calibrate import Outcome, UniformOutcome
from skincal.calibration import Calibration
from skincal.dataset import Dataset
from skincal.diagnosis.diagnosis import Diagnosis
from skincal.report.diagnosis_words import capital, gap_sentence, headline

Row = Sequence[str]
_FINDINGS, _CELL = 4, "text-align:left; padding:0 1em 0 0"


@singledispatch
def card(result: object) -> str:
    """A result as HTML.

    Args:
        result: a dataset, a calibration, a fit or a diagnosis.

    Raises:
        TypeError: it is none of these.
    """
    raise TypeError(f"expected a result of skincal, got {type(result).__name__}")


@card.register
def _(result: Dataset) -> str:
    sensor, presses = result.meta.sensor, result.presses
    force = presses.force_n[np.isfinite(presses.force_n)]
    spread = f"{force.min():.3g} to {force.max():.3g} N" if len(force) else "not known"
    frames = "none" if result.frames is None else f"{len(result.frames)}"
    rows = [
        ("presses", f"{len(presses)}, {spread}"),
        ("frames", frames),
        ("sensor", f"{sensor.rows} × {sensor.cols} taxels on a {result.meta.surface.kind}"),
        ("indenter", result.meta.indenter.kind),
    ]
    name = result.folder.name if result.folder else "dataset"
    return _titled(f"{name}: {len(presses)} presses", rows)


@card.register
def _(result: Calibration) -> str:
    best = result.model.best()
    rows: list[Row] = [("", "best", "interval")]
    for name, value in best.items():
        low, high = result.intervals.get(name, (-np.inf, np.inf))
        told = f"{low:.4g} to {high:.4g}" if np.isfinite(low) and np.isfinite(high) else "not told"
        rows.append((name, f"{value:.4g}", told))
    for effect in result.effects:
        for name, value in effect.parameters.items():
            array = np.asarray(value)
            several = array.ndim > 0
            text = (
                f"{array.min():.3g} to {array.max():.3g}, {array.size} values"
                if several
                else f"{float(array):.4g}"
            )
            rows.append((f"{effect.name}: {name}", text, ""))
    error = float(np.sqrt(result.loss.mse_counts2))
    title = f"Calibration: {error:.3g} {result.sensor.unit_label} rms on {result.loss.presses_used} presses"
    return _titled(title, rows) + _findings(f.text for f in result.findings if f.severity == "warning")


@card.register
def _(result: Outcome) -> str:
    return card(result.calibration)


@card.register
def _(result: UniformOutcome) -> str:
    return card(result.calibration)


@card.register
def _(result: Diagnosis) -> str:
    rows: list[Row] = [("effect", "parameter", "value", "95 %")]
    for effect in result.effects:
        for name, (low, high) in effect.intervals.items():
            array = np.asarray(effect.parameters[name])
            several = array.ndim > 0
            value = f"{array.min():.3g} to {array.max():.3g}" if several else f"{float(array):.4g}"
            ends = "one each" if several else f"{float(low):.4g} to {float(high):.4g}"
            rows.append((effect.name, name, value, ends))
    lines = [capital(gap_sentence(result)) + "."]
    lines += [result.where[:1].upper() + result.where[1:] + "."] if result.verdict == "unknown" else []
    text = "".join(f"<p>{escape(line)}</p>" for line in lines)
    table = rows if len(rows) > 1 else []
    return (
        _titled(headline(result), table)
        + text
        + _findings(f.text for f in result.findings if f.severity == "warning")
    )


def _titled(title: str, rows: Iterable[Row]) -> str:
    body = "".join(
        "<tr>" + "".join(f'<td style="{_CELL}">{escape(cell)}</td>' for cell in row) + "</tr>" for row in rows
    )
    return f"<strong>{escape(title)}</strong>" + (f"<table>{body}</table>" if body else "")


def _findings(texts: Iterable[str]) -> str:
    own = list(texts)
    more = [f"and {len(own) - _FINDINGS} more"] if len(own) > _FINDINGS else []
    items = "".join(f"<li>{escape(text)}</li>" for text in [*own[:_FINDINGS], *more])
    return f"<ul>{items}</ul>" if items else ""
