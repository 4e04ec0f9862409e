"""The result of a fit in words and small tables: the part of the report to read first."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skincal.calibration import Calibration
from skincal.calibration.parts import Numbers
from skincal.dataset import Dataset
from skincal.fitting.result import FitResult
from skincal.report.fit_presses import why_unused
from skincal.report.fit_quantities import Quantity, quantities, with_digits

EXPLAINED = 1.5
"""Residuals up to this multiple of the noise count as explained."""


@dataclass(frozen=True)
class EffectRow:
    """A parameter of an effect fitted with the base model, in words; lists are given by their ends."""

    effect: str
    name: str
    value: str
    low: str
    high: str


@dataclass(frozen=True)
class ParameterRow:
    """A line of the table of intervals.

    Attributes:
        name: name of the parameter, with its unit.
        best: best value.
        low: lower end of the interval; empty if the data do not bound it.
        high: upper end.
        searched: the searched range in words.
        share: width of the interval relative to the searched range, in words.
        share_percent: the same as a number for a bar, 0 to 100; None without a search.
        start_percent: start of the bar.
    """

    name: str
    best: str
    low: str
    high: str
    searched: str
    share: str
    share_percent: float | None = None
    start_percent: float = 0.0


@dataclass(frozen=True)
class ScatterRow:
    """A line of the table of scatter, in words: the quantity, its declared and its estimated value."""

    what: str
    declared: str
    found: str
    remark: str


@dataclass(frozen=True)
class PressRow:
    """A line of the table of presses, in words; empty where there is nothing to report."""

    press: str
    force: str
    active: str
    outcome: str
    across: str
    along: str
    rmse: str
    good: bool


def headline(result: FitResult) -> tuple[bool, str]:
    """Return whether nothing needs attention, and a headline that says so."""
    warnings = sum(finding.severity == "warning" for finding in result.findings)
    if not warnings:
        return True, "Nothing needs attention. The calibration can be used as it is."
    if not result.told:
        return False, "Do not use this calibration: the data do not determine its parameters."
    things = "One thing needs" if warnings == 1 else f"{warnings} things need"
    return False, f"{things} attention before you rely on this calibration."


def verdict(result: FitResult) -> list[str]:
    """Return a few sentences to act on: presses, parameters, quality of the fit."""
    return [
        _about_presses(result),
        _about_parameters(result),
        *_about_taxels(result),
        _about_images(result),
        _about_positions(result),
    ]


def _about_presses(result: FitResult) -> str:
    all_of, used = len(result.problem.status), len(result.problem)
    unused = why_unused(result)
    if not unused:
        return f"All {all_of} presses were used."
    reasons = "; ".join(f"{count} with {reason}" for reason, count in unused)
    return f"{used} of {all_of} presses were used. Not used: {reasons}."


def _about_parameters(result: FitResult) -> str:
    named = ", ".join(
        f"{q.label} = {q.shown(q.best)} {q.unit} ({_range(q)})".replace(" °", "°") for q in quantities(result)
    )
    return f"Best parameters, with their intervals: {named}."


def _range(of: Quantity) -> str:
    return f"{of.shown(of.low)} to {of.shown(of.high)}" if of.identified else "not identified"


def _about_taxels(result: FitResult) -> list[str]:
    scales = result.scale_per_taxel_per_n
    if scales is None:
        return []
    cols = result.problem.rig.layout.cols
    least, most = (
        f"{scales[j]:.3g} of taxel ({j // cols}, {j % cols})" for j in (np.argmin(scales), np.argmax(scales))
    )
    return [
        f"Each taxel has its own scale, from {least} to {most} 1/N; they differ by "
        f"{100 * float(np.std(np.log(scales))):.2g} % rms."
    ]


def _about_images(result: FitResult) -> str:
    found, floor = result.sigmas.noise_counts, result.problem.noise_sigma_counts
    reason = "the noise explains all of it" if _explained(result) else "the model lacks something"
    return (
        f"At the best point simulated and measured images differ by {result.mse_counts2**0.5:.2g} counts rms per taxel "
        f"(loss {result.mse_counts2:.3g} counts²). Values of touched taxels scatter by {found:.2g} counts around the "
        f"model; the sensor's own noise is {floor:.2g} counts: {reason}."
    )


def _explained(result: FitResult) -> bool:
    """Return whether the noise of the sensor explains the differences of the images."""
    return result.sigmas.noise_counts <= max(EXPLAINED * result.problem.noise_sigma_counts, 0.5)


def _about_positions(result: FitResult) -> str:
    rms = 1e3 * float(np.sqrt(np.mean(result.presses.slack_m**2))) if len(result.problem) else 0.0
    bad = int((~result.presses.good).sum())
    well = "All presses used are matched well" if not bad else f"{bad} of the presses used are matched badly"
    return f"{well}. For this match, contact positions were moved by {rms:.2f} mm rms along each direction."


def parameter_rows(result: FitResult) -> list[ParameterRow]:
    """Return the table of intervals."""
    return [_parameter_row(q) for q in quantities(result)]


def _parameter_row(of: Quantity) -> ParameterRow:
    best = of.shown(of.best)
    low, high = (of.shown(of.low), of.shown(of.high)) if of.identified else ("", "")
    if of.searched is None:
        return ParameterRow(of.axis_label, best, low, high, "any (found by least squares)", "–")
    searched = f"{of.searched[0]:.5g} to {of.searched[1]:.5g}".replace("-", "−")
    ends = np.array(of.searched)
    interval = np.array([of.low, of.high]) if of.identified else ends
    if of.logarithmic:
        ends, interval = np.log(ends), np.log(interval)
    if ends[1] <= ends[0]:
        return ParameterRow(of.axis_label, best, low, high, f"fixed at {of.searched[0]:.5g}", "–")
    start, end = np.clip((interval - ends[0]) / (ends[1] - ends[0]), 0.0, 1.0)
    share = f"{100 * (end - start):.2g} %" if of.identified else "all of it"
    width = max(100 * (end - start), 1.0)
    return ParameterRow(of.axis_label, best, low, high, searched, share, width, min(100 * start, 100 - width))


def effect_rows(calibration: Calibration) -> list[EffectRow]:
    """Return the effects of a calibration, parameter by parameter."""
    rows: list[EffectRow] = []
    for effect in calibration.effects:
        for name, given in effect.parameters.items():
            ends = [_ends(given), *map(_ends, effect.intervals.get(name, ()))]
            value, low, high = ends if len(ends) == 3 else (ends[0], "", "")
            rows.append(EffectRow(effect.name, name, value, low, high))
    return rows


def _ends(numbers: Numbers) -> str:
    values = np.atleast_1d(np.asarray(numbers, dtype=np.float64))
    low, high = f"{values.min():.4g}", f"{values.max():.4g}"
    return (low if low == high else f"{low} to {high}").replace("-", "−")


def scatter_rows(result: FitResult) -> list[ScatterRow]:
    """Return the table of scatter: position, force, image."""
    rig, found = result.problem.rig, result.sigmas
    declared = rig.position_sigma_m
    position = "as declared"
    if np.isfinite(declared):
        ratio = found.position_m / declared if declared > 0 else np.inf
        if ratio > 1.5:
            position = "larger than declared"
        elif ratio < 0.6:
            position = "smaller than declared: a smaller sigma_m narrows the search"
    else:
        position = "not declared"
    floor = result.problem.noise_sigma_counts
    image = "explained by noise" if _explained(result) else "more than noise explains"
    return [
        ScatterRow(
            "contact position, each direction",
            f"{1e3 * declared:.2g} mm" if np.isfinite(declared) else "nothing",
            f"{1e3 * found.position_m:.2g} mm",
            position,
        ),
        ScatterRow("force", "–", f"{100 * found.force:.2g} %", "of the measured force"),
        ScatterRow(
            "hold mean of a taxel", f"{floor:.2g} counts at rest", f"{found.noise_counts:.2g} counts", image
        ),
    ]


def press_rows(result: FitResult, dataset: Dataset) -> list[PressRow]:
    """Return the table of all presses, in the order of the dataset."""
    problem, presses = result.problem, result.presses
    place = {int(row): k for k, row in enumerate(problem.rows)}
    rows = []
    for row, (number, status) in enumerate(zip(dataset.presses.press, problem.status, strict=True)):
        force, active = f"{dataset.presses.force_n[row]:.3g}", str(int(problem.active[row]))
        k = place.get(row)
        if k is None:
            rows.append(PressRow(str(number), force, active, status, "", "", "", True))
            continue
        across, along = (with_digits(1e3 * v, 1.0) for v in presses.slack_m[k])
        good = bool(presses.good[k])
        outcome = "used" if good else "used, matches badly"
        rows.append(
            PressRow(
                str(number), force, active, outcome, across, along, f"{presses.rmse_counts[k]:.2g}", good
            )
        )
    return rows


def provenance_rows(calibration: Calibration) -> list[tuple[str, str]]:
    """Return the provenance of the calibration, as names and words."""
    from_ = calibration.provenance
    options = ", ".join(f"{name} = {_plain(value)}" for name, value in from_.options.items())
    rows = [
        ("dataset", from_.dataset),
        ("its SHA-256", from_.dataset_sha256),
        ("skincal", from_.version),
        ("command", from_.command),
        ("seed", "" if from_.seed is None else str(from_.seed)),
        ("time", "" if from_.time is None else from_.time.isoformat(sep=" ")),
        ("options", options),
    ]
    return [(name, words) for name, words in rows if words]


def _plain(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{k} = {_plain(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_plain(v) for v in value) + "]"
    return str(value)
