"""From a recording to presses: check it, put it on one clock, and cut it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skincal.dataset import Frames, Presses
from skincal.dataset.columns import repeated
from skincal.dataset.findings import Findings, listed
from skincal.dataset.impossible import IMPOSSIBLE
from skincal.errors import InputError, first_of, input_error
from skincal.imports import targets
from skincal.imports.cutting import check_phases, cut, cut_by_taxels, cut_numbered, in_contact
from skincal.imports.dataset_tables import presses_of_rows, tables_of_series
from skincal.imports.mapping import Mapping
from skincal.imports.mapping_file import CutRules
from skincal.imports.recording import BoolArray, Cut, Dropped, FloatArray, Recording, Series, summed
from skincal.imports.resting import rested
from skincal.imports.spikes import find_spikes

SPIKES = 0.001
"""Part of the samples that may be spikes of the force sensor."""


def presses_and_frames(
    recording: Recording, mapping: Mapping, findings: Findings
) -> tuple[Presses, Frames | None, tuple[Dropped, ...]]:
    """Return the presses of a recording in the fingertip frame, its frames, and what was left out.

    There are no frames if each row of the source is a press.

    Raises:
        InputError: the recording cannot be cut into presses.
    """
    _check_numbers(recording, mapping, findings)
    findings.raise_errors()
    if mapping.rows == targets.PRESSES:
        presses = presses_of_rows(recording)
        if (twice := repeated(presses.press)).any():
            got = f"{listed(presses.press[twice][:3].tolist(), int(twice.sum()))} again"
            fix = "The same press twice? Without [columns.press] presses are counted."
            findings.error(f"{_where(recording, twice)}, press", "each number once", got, fix)
        findings.raise_errors()
        return presses, None, recording.dropped
    file, rules = first_of(file.file for file in recording.files), mapping.cut
    series = _series(recording, rules, file, findings)
    findings.raise_errors()
    if rules.by == "taxels":
        found = cut_by_taxels(series, recording.counts, rules)
        series = replace(series, force_n=in_contact(series.force_n, found, mapping))
    else:
        found = cut(series, rules) if series.press is None else cut_numbered(series, rules, file, findings)
        if rules.by == "force" and series.press is None:
            _check_released(series, rules, file, findings)
    findings.raise_errors()
    found = rested(found, series, recording, mapping, file, findings)
    if not found.spans:
        raise _no_press(series, found, rules, file)
    dropped = [*recording.dropped]
    for rejected in found.rejected:
        frames = Dropped(rejected.stop - rejected.start, "frame", "of such a contact")
        dropped += [Dropped(1, "contact", rejected.why), frames]
    recording = _without_spikes(recording, found, file, findings)
    return *tables_of_series(recording, series, found), summed(dropped)


def _without_spikes(recording: Recording, found: Cut, file: str, findings: Findings) -> Recording:
    """Return the recording with spikes set to NaN; add their number to the findings."""
    spikes = find_spikes(recording.counts, found)
    if not spikes.any():
        return recording
    findings.note(
        file, "readings that go with those before and after",
        f"{spikes.sum()} single ones, in {spikes.any(axis=1).sum()} samples, that jump and return: taxels dropped out",
        "They are left out. Look at the connection of the sensor.", code=IMPOSSIBLE,
    )  # fmt: skip
    return replace(recording, counts=np.where(spikes, np.nan, recording.counts))


def _check_released(series: Series, rules: CutRules, file: str, findings: Findings) -> None:
    """Warn of a force that is never that of no contact: then the whole recording is one."""
    least = float(np.quantile(series.force_n, SPIKES)) if len(series) else 0.0
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


def _series(recording: Recording, rules: CutRules, file: str, findings: Findings) -> Series:
    time = _one_clock(recording, rules, findings)
    numbers, phase = recording.columns.get("press"), recording.columns.get("phase")
    if phase is not None:
        check_phases(phase, file, findings)
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


def _where(recording: Recording, bad: BoolArray) -> str:
    """Return the file and rows of the first places where a mask holds."""
    rows = np.flatnonzero(bad)
    part = int(recording.part[rows[0]])
    begin = int(np.flatnonzero(recording.part == part)[0])
    named = first_of(rows[recording.part[rows] == part] - begin + 1, total=len(rows))
    return f"{recording.files[part].file}, {'row' if len(rows) == 1 else 'rows'} {named}"


def _no_press(series: Series, found: Cut, rules: CutRules, file: str) -> InputError:
    """Return the error of a series without a press, with the reasons of its contacts and its range of forces."""
    reasons, force = sorted({rejected.why for rejected in found.rejected}), series.force_n
    top = f"forces from {force.min():.3g} N to {force.max():.3g} N" if len(series) else "no rows"
    got = f"none: {len(found.rejected)} contacts with {'; '.join(reasons)}" if reasons else "none"
    thresholds = f"on_n = {rules.on_n:g}, off_n = {rules.off_n:g}"
    fix = f"Look at the thresholds in [series] ({thresholds}), sign and unit of force_n."
    return input_error(file, "at least one press", f"{got} ({top})", "" if rules.by == "taxels" else fix)
