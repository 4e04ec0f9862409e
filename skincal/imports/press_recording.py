"""From a recording to presses: check it, put it on one clock, and cut it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from skincal.dataset import Frames, Presses
from skincal.dataset.columns import repeated
from skincal.dataset.findings import Findings, listed
from skincal.imports import targets
from skincal.imports.cutting import check_phases, cut, cut_by_taxels, cut_numbered, in_contact
from skincal.imports.dataset_tables import presses_of_rows, tables_of_series
from skincal.imports.mapping import Mapping
from skincal.imports.mapping_file import CutRules
from skincal.imports.recording import Cut, Dropped, FloatArray, Recording, Series, summed
from skincal.imports.resting import rested

SPIKES = 0.001
"""Part of the samples that may be spikes of the force sensor."""


def presses_and_frames(
    recording: Recording, mapping: Mapping, findings: Findings
) -> tuple[Presses, Frames | None, tuple[Dropped, ...]] | None:
    """Return the presses of a recording in the fingertip frame, its frames, and what was left out.

    None, with errors, if it cannot be cut. There are no frames if each row of the source is a press.
    """
    _check_numbers(recording, mapping, findings)
    if findings.errors:
        return None
    if mapping.rows == targets.PRESSES:
        presses = presses_of_rows(recording)
        _check_unique(recording, presses.press, findings)
        return presses, None, recording.dropped
    series = _series(recording, mapping, findings)
    if findings.errors:
        return None
    file, rules = _file_names(recording), mapping.cut
    if rules.by == "taxels":
        found = cut_by_taxels(series, recording.counts, rules)
        series = replace(series, force_n=in_contact(series.force_n, found, mapping))
    else:
        found = cut(series, rules) if series.press is None else cut_numbered(series, rules, file, findings)
        if rules.by == "force" and series.press is None:
            _check_released(series, rules, file, findings)
    if not findings.errors:
        found = rested(found, series, recording, mapping, file, findings)
    if not found.spans and not findings.errors:
        hint = "" if rules.by == "taxels" else _cut_hint(rules)
        findings.error(file, "at least one press", _why_none(series, found), hint)
    if findings.errors:
        return None
    dropped = summed((*recording.dropped, *_rejections(found)))
    return *tables_of_series(recording, series, found), dropped


def _check_released(series: Series, rules: CutRules, file: str, findings: Findings) -> None:
    """Warn of a force that is never that of no contact: then the whole recording is one."""
    if not len(series):
        return
    least = float(np.quantile(series.force_n, SPIKES))
    if least > rules.off_n:
        findings.warn(
            f"{file}, force_n", f"forces below off_n = {rules.off_n:g} N where nothing touches",
            f"{least:.3g} N at least, so that the whole recording is one contact",
            "If the zero of the force sensor is off, or a preload was on it, take it off: offset in "
            "[columns.force_n], in the unit of the column. Or raise on_n and off_n in [series].",
            code="zero_of_force",
        )  # fmt: skip


def _check_numbers(recording: Recording, mapping: Mapping, findings: Findings) -> None:
    """Check that numbers of presses are whole; an empty cell of a series means no press."""
    numbers = recording.columns.get("press")
    if numbers is None:
        return
    low = 0 if mapping.rows == targets.PRESSES else -1
    bad = np.isfinite(numbers) & ((numbers != np.rint(numbers)) | (numbers < low))
    if bad.any():
        expected = "whole numbers, 0 or more" + ("" if low == 0 else ", or -1 or nothing between presses")
        got = listed([float(value) for value in numbers[bad][:3]], int(bad.sum()))
        findings.error(f"{_where(recording, bad)}, press", expected, got)


def _check_unique(recording: Recording, press: NDArray[np.int64], findings: Findings) -> None:
    twice = repeated(press)
    if twice.any():
        again = press[twice]
        got = f"{listed(again[:3].tolist(), len(again))} again"
        fix = "The same press twice? Without [columns.press] presses are counted."
        findings.error(f"{_where(recording, twice)}, press", "each number once", got, fix)


def _series(recording: Recording, mapping: Mapping, findings: Findings) -> Series:
    time = _one_clock(recording, mapping.cut, findings)
    numbers, phase = recording.columns.get("press"), recording.columns.get("phase")
    if phase is not None:
        check_phases(phase, _file_names(recording), findings)
    press = None if numbers is None else np.where(np.isfinite(numbers), numbers, -1).astype(np.int64)
    return Series(time, recording.columns["force_n"], recording.part, press, phase)


def _one_clock(recording: Recording, rules: CutRules, findings: Findings) -> FloatArray:
    """Return the times of all files on one clock [s], shape (M,)."""
    time = np.array(recording.columns["time_s"], dtype=np.float64)
    if rules.own_clocks:
        for part in range(1, len(recording.files)):
            here, before = recording.part == part, recording.part == part - 1
            if here.any() and before.any():
                time[here] += time[before][-1] + rules.gap_s - time[here][0]
    back = np.zeros(len(time), dtype=bool)
    back[1:] = np.diff(time) < 0
    if back.any():
        row = int(np.flatnonzero(back)[0])
        fix = "Set own_clocks = true in [series], or give the files in order."
        got = f"{time[row]:.6g} s after {time[row - 1]:.6g} s"
        findings.error(f"{_where(recording, back)}, time_s", "times in order", got, fix)
    return time - time[0] if rules.start_at_zero and len(time) else time


def _where(recording: Recording, bad: NDArray[np.bool_]) -> str:
    """Return the file and rows of the first places where a mask holds."""
    rows = np.flatnonzero(bad)
    part = int(recording.part[rows[0]])
    begin = int(np.flatnonzero(recording.part == part)[0])
    same = rows[recording.part[rows] == part] - begin + 1
    named = ", ".join(str(row) for row in same[:3]) + (f" and {len(rows) - 3} more" if len(rows) > 3 else "")
    return f"{recording.files[part].file}, {'row' if len(rows) == 1 else 'rows'} {named}"


def _file_names(recording: Recording) -> str:
    names = [file.file for file in recording.files]
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")


def _rejections(found: Cut) -> list[Dropped]:
    dropped: list[Dropped] = []
    for rejected in found.rejected:
        dropped.append(Dropped(1, "contact", rejected.why))
        dropped.append(Dropped(rejected.stop - rejected.start, "frame", "of such a contact"))
    return dropped


def _why_none(series: Series, found: Cut) -> str:
    reasons = sorted({rejected.why for rejected in found.rejected})
    top = (
        f"forces from {series.force_n.min():.3g} N to {series.force_n.max():.3g} N"
        if len(series)
        else "no rows"
    )
    return (
        f"none: {len(found.rejected)} contacts with {'; '.join(reasons)} ({top})"
        if reasons
        else f"none ({top})"
    )


def _cut_hint(rules: CutRules) -> str:
    thresholds = f"on_n = {rules.on_n:g}, off_n = {rules.off_n:g}"
    return f"Look at the thresholds in [series] ({thresholds}), sign and unit of force_n."
