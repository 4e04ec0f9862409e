"""From a recording to presses: check it, put it on one clock, cut it, and make the tables of a dataset."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Final

import numpy as np
import pandas as pd

from skincal.covariates import NORMAL, POSITION, TIMES
from skincal.dataset import HOLD, IDLE, Frames, Presses
from skincal.dataset.columns import repeated
from skincal.dataset.corrections import IMPOSSIBLE
from skincal.dataset.findings import Findings, listed
from skincal.errors import InputError, first_of, input_error
from skincal.imports import targets
from skincal.imports.contact_positions import with_positions
from skincal.imports.cutting import check_phases, cut, cut_by_taxels, cut_numbered, phases
from skincal.imports.force_zero import check_option, check_released, check_zero, zeroed
from skincal.imports.labelled_force import check_labelled, cut_labelled, in_contact, is_labelled
from skincal.imports.mapping import Mapping
from skincal.imports.mapping_file import CutRules
from skincal.imports.recording import (
    BoolArray,
    Column,
    Cut,
    Dropped,
    FloatArray,
    Recording,
    Series,
    Span,
    runs,
    summed,
)
from skincal.imports.resting import rested
from skincal.model.rest import rounding_step


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
    check_option(mapping, findings)
    series = _series(recording, rules, file, findings)
    findings.raise_errors()
    labelled = is_labelled(series, recording.counts, rules)
    if labelled:
        check_labelled(series, mapping, file, findings)
        rules = rules if series.press is not None else replace(rules, by="taxels")
        found = cut_labelled(series, recording.counts, rules, file, findings)
        series = in_contact(series, found)
    else:
        found = _cut(series, recording, rules, file, findings)
    findings.raise_errors()
    if not labelled and mapping.measures("force_n"):
        spikes = _spikes_of_force(series, recording, rules)
        if spikes.any():
            recording, series = _without_samples(recording, spikes, file, findings), series.select(~spikes)
            found = _cut(series, recording, rules, file, findings)
        if rules.zero_force:
            series = zeroed(series, found)
            found = _cut(series, recording, rules, file, findings)
        if rules.by == "force" and series.press is None:
            check_released(series, recording.counts, mapping, file, findings)
        check_zero(series, found, mapping, file, findings)
    found = rested(found, series, recording, mapping, file, findings)
    recording, series, found = with_positions(recording, series, found, mapping, findings)
    findings.raise_errors()
    if not found.spans:
        raise _no_press(series, found, rules, file)
    dropped = [*recording.dropped]
    for rejected in found.rejected:
        frames = Dropped(rejected.stop - rejected.start, "frame", "of such a contact")
        dropped += [Dropped(1, "contact", rejected.why), frames]
    recording = _without_spikes(recording, found, file, findings)
    return *tables_of_series(recording, series, found), summed(dropped)


def _cut(series: Series, recording: Recording, rules: CutRules, file: str, findings: Findings) -> Cut:
    if rules.by == "taxels":
        return cut_by_taxels(series, recording.counts, rules)
    return cut(series, rules) if series.press is None else cut_numbered(series, rules, file, findings)


def _spikes_of_force(series: Series, recording: Recording, rules: CutRules) -> BoolArray:
    """Return the samples (M,) whose force jumps and returns, in the phases of presses that no spike cuts in two."""
    spikes = np.zeros(len(series), dtype=bool)
    while True:
        left = series.select(~spikes)
        calm = left.force_n.copy()
        calm[1:-1] = np.median([calm[:-2], calm[1:-1], calm[2:]], axis=0)
        found = _cut(replace(left, force_n=calm), recording.select(~spikes), rules, "", Findings())
        more = find_spikes(left.force_n[:, None], found)[:, 0]
        if not more.any():
            return spikes
        # Of several in a short phase, some hide others, as they add to its noise.
        spikes[np.flatnonzero(~spikes)[more]] = True


def _without_samples(recording: Recording, spikes: BoolArray, file: str, findings: Findings) -> Recording:
    findings.note(
        f"{file}, force_n", "forces that go with those before and after",
        f"{spikes.sum()} single ones that jump and return: the force dropped out, or was disturbed",
        "These samples are left out. Look at the connection of the force sensor.", code=IMPOSSIBLE,
    )  # fmt: skip
    return recording.without("sample", {"force that jumps and returns": spikes})


def _without_spikes(recording: Recording, found: Cut, file: str, findings: Findings) -> Recording:
    spikes = find_spikes(recording.counts, found)
    if not spikes.any():
        return recording
    findings.note(
        file, "readings that go with those before and after",
        f"{spikes.sum()} single ones, in {spikes.any(axis=1).sum()} samples, that jump and return: taxels dropped out",
        "They are left out. Look at the connection of the sensor.", code=IMPOSSIBLE,
    )  # fmt: skip
    return replace(recording, counts=np.where(spikes, np.nan, recording.counts))


def _check_numbers(recording: Recording, mapping: Mapping, findings: Findings) -> None:
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
    rows = np.flatnonzero(bad)
    part = int(recording.part[rows[0]])
    named = first_of(recording.row[rows[recording.part[rows] == part]] + 1, total=len(rows))
    return f"{recording.files[part].file}, {'row' if len(rows) == 1 else 'rows'} {named}"


def _no_press(series: Series, found: Cut, rules: CutRules, file: str) -> InputError:
    """Return the error of a series without a press, with the reasons of its contacts and its range of forces."""
    reasons, force = sorted({rejected.why for rejected in found.rejected}), series.force_n
    top = f"forces from {force.min():.3g} N to {force.max():.3g} N" if len(series) else "no rows"
    got = f"none: {len(found.rejected)} contacts with {'; '.join(reasons)}" if reasons else "none"
    thresholds = f"on_n = {rules.on_n:g}, off_n = {rules.off_n:g}"
    fix = f"Look at the thresholds in [series] ({thresholds}), sign and unit of force_n."
    return input_error(file, "at least one press", f"{got} ({top})", "" if rules.by == "taxels" else fix)


SPIKE_SIGMAS: Final = 10.0
"""Least jump of a spike, in standard deviations of the noise of its stretch and of the taxel; chance makes none."""

SPIKE_STEPS: Final = 2.5
"""Least jump in steps of the converter: coarse readings jump by one step although their noise looks like zero."""

MOST_SPIKES: Final = 0.05
"""Largest part of readings that may be spikes; more are taken for the signal (set by eye)."""

FEWEST_STEPS: Final = 4
"""Smallest number of differences from which the noise of a stretch is estimated."""

NOISE_QUANTILE, NOISE_SIGMAS = 0.8, 1.2816
"""Quantile of absolute differences that gives the noise, and its value for a standard normal."""


def find_spikes(counts: FloatArray, cut: Cut) -> BoolArray:
    """Find the readings that jump and return within one sample, of samples (M, J), NaN where not read.

    The noise is estimated in each phase of a press and each stretch of rest. There are none if there would be too many.
    """
    spikes, looked = np.zeros(counts.shape, dtype=bool), 0
    if len(counts) <= FEWEST_STEPS:
        return spikes
    idle = np.ones(len(counts), dtype=bool)
    for one in (*cut.spans, *cut.rejected):
        idle[one.start : one.stop] = False
    least = SPIKE_STEPS * rounding_step(counts[np.isfinite(counts)])
    usual = _noise(np.diff(counts, axis=0))
    edges = [(span.start, span.hold, span.hold_stop, span.stop) for span in cut.spans]
    for start, end in (*(ends for four in edges for ends in pairwise(four)), *runs(idle)):
        first, stop = max(start - 1, 0), min(end + 1, len(counts))
        part = counts[first:stop, alive := np.isfinite(counts[first:stop]).any(axis=0)]
        steps = np.diff(part, axis=0)
        if len(steps) < FEWEST_STEPS:
            continue
        looked += steps[1:].size
        limit = np.maximum(SPIKE_SIGMAS * np.maximum(_noise(steps), usual[alive]), least)
        before, after = steps[:-1], steps[1:]
        far = np.minimum(np.abs(before), np.abs(after))
        far = np.minimum(far, np.abs(part[1:-1] - np.nanmedian(part, axis=0)))
        spikes[first + 1 : stop - 1, alive] |= (np.sign(before) == -np.sign(after)) & (far > limit)
    return spikes if spikes.sum() <= MOST_SPIKES * looked else np.zeros_like(spikes)


def _noise(steps: FloatArray) -> FloatArray:
    """Estimate the noise of each taxel (J,) from differences (n, J) of successive readings."""
    return np.quantile(np.abs(np.nan_to_num(steps)), NOISE_QUANTILE, axis=0) / (np.sqrt(2) * NOISE_SIGMAS)


OWN = ("press", "phase", "time_s", "force_n", *POSITION)


def presses_of_rows(recording: Recording) -> Presses:
    """Return the presses of a recording with one row per press; without numbers they are counted from 0."""
    numbers = recording.columns.get("press")
    taken = ("press", "force_n", *POSITION, *NORMAL)
    return Presses(
        press=np.arange(len(recording)) if numbers is None else numbers.astype(np.int64),
        position_m=recording.vector(POSITION),
        force_n=recording.columns["force_n"],
        counts=recording.counts,
        normals=_normals(recording),
        columns={name: column for name, column in recording.columns.items() if name not in taken},
    )


def tables_of_series(recording: Recording, series: Series, cut: Cut) -> tuple[Presses, Frames]:
    """Return the hold means of every press, and the frames without samples of rejected spans."""
    press = np.full(len(series), -1, dtype=np.int64)
    kept = np.ones(len(series), dtype=bool)
    for rejected in cut.rejected:
        kept[rejected.start : rejected.stop] = False
    # A sample without any reading is no image.
    kept &= np.isfinite(recording.counts).any(axis=1) | ~np.isfinite(recording.counts).any()
    for span in cut.spans:
        press[span.start : span.stop] = span.number
    phase = phases(series, cut.spans)
    position = np.where((phase == IDLE)[:, None], np.nan, recording.vector(POSITION))
    columns = {name: column for name, column in recording.columns.items() if name not in OWN}
    frames = Frames(press, phase, series.time_s, series.force_n, position, recording.counts, columns)
    return _presses(recording, series, cut.spans, phase == HOLD), frames.select(kept)


def _presses(recording: Recording, series: Series, spans: tuple[Span, ...], held: BoolArray) -> Presses:
    """Return the presses of spans; ``held`` (M,) says which samples within their holds count."""
    rows = [np.arange(span.hold, span.hold_stop) for span in spans]
    rows = [row[held[row]] for row in rows]
    press, together = np.repeat(np.arange(len(spans)), [len(row) for row in rows]), np.concatenate(rows)

    def means(values: FloatArray) -> FloatArray:
        """Return means of measured values over each hold, (K,) or (K, columns); NaN where nothing was measured."""
        means = pd.DataFrame(values[together]).groupby(press).mean().reindex(range(len(spans))).to_numpy()
        return means[:, 0] if values.ndim == 1 else means

    marks = [(span.start, span.hold, span.hold_stop - 1, span.stop - 1) for span in spans]
    columns: dict[str, Column] = dict(zip(TIMES, series.time_s[np.array(marks)].T, strict=True))
    if any(span.branch for span in spans) and "branch" not in recording.columns:
        columns["branch"] = np.array([span.branch for span in spans], dtype=object)
    for name, column in recording.columns.items():
        if name not in (*OWN, *NORMAL):
            of_press = column.dtype == object or name in targets.LABELS
            columns[name] = column[[span.hold for span in spans]] if of_press else means(column)
    normals = _normals(recording)
    if normals is not None:
        normals = means(normals)
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        normals = normals / np.where(length > 0, length, np.nan)
    return Presses(
        press=np.array([span.number for span in spans], dtype=np.int64),
        position_m=means(recording.vector(POSITION)),
        force_n=means(series.force_n),
        counts=means(recording.counts),
        normals=normals,
        columns=columns,
    )


def _normals(recording: Recording) -> FloatArray | None:
    return recording.vector(NORMAL) if any(name in recording.columns for name in NORMAL) else None
