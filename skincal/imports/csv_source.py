"""Reader of text files and other tables: a recording in SI, joined by time with files that have their own clocks."""

from __future__ import annotations

from collections.abc import Mapping as Map
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from fnmatch import fnmatch
from pathlib import Path

import numpy as np
import pandas as pd

from skincal.covariates import POSITION
from skincal.dataset.findings import Findings, listed
from skincal.errors import input_error
from skincal.imports import targets
from skincal.imports.alignment import JoinedClock, NoOffsetError, estimate_offset
from skincal.imports.clock import DAY_S, resampled, usual_step
from skincal.imports.mapping import JoinedFile, Mapping, Quantity, source_columns
from skincal.imports.mapping_file import DROP_INCOMPLETE, CsvFormat, CsvSource
from skincal.imports.place_alignment import estimate_offset_by_place
from skincal.imports.recording import Column, FloatArray, ReadFile, Recording, joined
from skincal.imports.source_table import read_source_tables
from skincal.imports.stamps import Kind, read_clock
from skincal.imports.text_table import TextTable, column_names


def read_csv_files(mapping: Mapping, files: Sequence[Path], findings: Findings) -> Recording:
    """Return files with one row per row of those with the taxels.

    Raises:
        InputError: a file is missing or cannot be read, or its cells or its clock have errors.
    """
    form = mapping.source
    assert isinstance(form, CsvSource)
    paths, others = assigned(mapping.joined, files, mapping.path.parent)
    own = [q for q in mapping.quantities if not q.topic]
    numbers, texts = source_columns(own)
    numbers += dict.fromkeys(mapping.taxels.names)
    tables = read_source_tables(paths, form, numbers, texts, findings)
    if len(tables) < len(paths):
        explain_missing(paths, form, mapping, findings)
        findings.raise_errors()
    parts = [_recording(mapping, form, own, i, table) for i, table in enumerate(tables)]
    if mapping.rows == targets.PRESSES:
        findings.raise_errors()
        return _complete(joined(parts), mapping, form)
    time = mapping.quantity("time_s")
    clock = read_clock(tables, time, form, findings, own_clocks=mapping.cut.own_clocks)
    findings.raise_errors()
    for i, (times, rows) in enumerate(zip(clock.times_s, clock.rows, strict=True)):
        part = parts[i].select(rows)
        parts[i] = replace(part, columns={"time_s": times, **part.columns})
    recording = replace(joined(parts), notes=clock.notes)
    for entry in mapping.joined:
        recording = join_file(recording, clock.kind, entry, others[entry.name], mapping, findings)
    return _complete(recording, mapping, form)


def _recording(
    mapping: Mapping, form: CsvSource, own: Sequence[Quantity], part: int, table: TextTable
) -> Recording:
    """Return one file; the clock of a time series is read separately, from all files together."""
    if mapping.rows == targets.SERIES:
        own = [q for q in own if q.target != "time_s"]
    columns = {q.target: q.column(table.rows, table.text, table.numbers) for q in own}
    raw = {name: table.numbers(name) for name in dict.fromkeys(mapping.taxels.names)}
    images = np.column_stack([raw[name] for name in mapping.taxels.names])
    parts, rows = np.full(table.rows, part, dtype=np.int64), np.arange(table.rows)
    read = (ReadFile(table.sheet.file, table.rows, table.sheet.lines),)
    recording = Recording(columns, mapping.taxels.counts(images), parts, rows, read)
    if form.drop_incomplete:
        return recording
    for quantity in own:
        if _needed(mapping, quantity):
            cells = [table.text(name) for name in quantity.sources]
            # Cells that are not numbers have been reported.
            reported = [column != "" for column in cells if column.dtype == object]
            missing = np.isnan(columns[quantity.target]) & ~np.any(reported or [[False]], axis=0)
            expected = f"a number ({quantity.target} is required in every row)"
            fix = DROP_INCOMPLETE
            name = ", ".join(quantity.sources)
            table.sheet.bad_rows(name, missing, np.full(table.rows, np.nan), expected, fix)
    return recording


def _complete(recording: Recording, mapping: Mapping, form: CsvSource) -> Recording:
    needed = [q for q in mapping.quantities if q.topic and q.target in mapping.required]
    why = "no {0} from {1} at their time (max_age_s in [files.{1}])".format
    missing = {why(q.target, q.topic): np.isnan(recording.columns[q.target]) for q in needed}
    recording = recording.without("frame", missing)
    if not form.drop_incomplete:
        return recording
    own = [q.target for q in mapping.quantities if not q.topic and _needed(mapping, q)]
    gaps = {name: np.isnan(recording.columns[name]) for name in own}
    lost = np.logical_or.reduce([np.zeros(len(recording), dtype=bool), *gaps.values()])
    why = f"no value in a required column ({', '.join(name for name in gaps if gaps[name].any())})"
    return recording.without("row", {why: lost})


def _needed(mapping: Mapping, quantity: Quantity) -> bool:
    """Return whether a column needs a value in every row; a clock fills its own gaps, and a rest needs no position."""
    if not quantity.sources or targets.is_text(quantity.target):
        return False
    if mapping.rows == targets.SERIES:
        return quantity.target == "force_n"
    return quantity.target in (*mapping.required, "press")


def explain_missing(paths: Sequence[Path], form: CsvFormat, mapping: Mapping, findings: Findings) -> None:
    """Replace the errors of missing columns by one error if another file holds them."""
    held = {path: column_names(path, form) for path in paths}

    def holder(names: Sequence[str]) -> Path | None:
        return next((path for path in paths if {*names} <= {*held[path]}), None)

    taxels = holder(mapping.taxels.names)
    if taxels is None:
        return
    elsewhere: dict[Path, list[str]] = {}
    for quantity in mapping.quantities:
        if not {*quantity.sources} <= {*held[taxels]}:
            if (other := holder(quantity.sources)) is None:
                return
            elsewhere.setdefault(other, []).append(quantity.target)
    if not elsewhere:
        return
    findings.errors.clear()
    for path, wanted in elsewhere.items():
        name = "".join(letter if letter.isalnum() else "_" for letter in path.stem)
        free = ", ".join(f'"{column}"' for column in held[path][:6])
        findings.error(
            path.name, f"the columns of {taxels.name}: files of one list follow each other in time",
            f"those of another device, with {', '.join(wanted)} (columns {free})",
            f'Describe it as a file with its own clock: [files.{name}] with file = "{path.name}" and '
            f'time = {{ column = "...", unit = "..." }}, and write file = "{name}" in '
            f"{', '.join(f'[columns.{target}]' for target in wanted)}.",
        )  # fmt: skip


STEPS_OLD = 3.0
"""Number of its own steps for which a value of a joined file is valid, if the mapping sets no time."""

APART_SIGMAS, APART_STEPS, LOOKED_S = 4.0, 2.0, 5.0
"""Clocks that should agree differ beyond this many sigmas and steps; where several lags are as good, the search is
limited to [s]:"""


ZONE_S = 900.0
"""Time zones differ by multiples of this [s]."""


def assigned(
    joined: Sequence[JoinedFile], given: Sequence[Path], folder: Path
) -> tuple[list[Path], dict[str, list[Path]]]:
    """Return the files of the command line that hold the taxels, and those of each table of ``[files]``.

    Raises:
        InputError: a file of ``[files]`` is neither given nor next to the mapping.
    """
    rest = list(given)
    found: dict[str, list[Path]] = {}
    for entry in joined:
        own = [path for path in rest if fnmatch(path.name, Path(entry.form.file).name)]
        rest = [path for path in rest if path not in own]
        found[entry.name] = own or sorted(folder.glob(entry.form.file))
        if not found[entry.name]:
            fix = "Give it on the command line, or put it next to the mapping."
            raise input_error(f"{entry.place} file", f"a file {entry.form.file}", "none", fix)
    # A file that holds both has a clock for each.
    return rest or list(given), found


def join_file(
    recording: Recording,
    kind: Kind,
    entry: JoinedFile,
    paths: Sequence[Path],
    mapping: Mapping,
    findings: Findings,
) -> Recording:
    """Return the recording with the columns of one joined file at the times of the taxels.

    Raises:
        InputError: the file cannot be read, or the offset of its clock is unknown.
    """
    quantities = [q for q in mapping.quantities if q.topic == entry.name]
    if entry.form.press:
        return join_by_press(recording, entry, paths, quantities, findings)
    numbers, texts = source_columns(quantities if entry.time is None else (*quantities, entry.time))
    tables = read_source_tables(paths, entry.form, numbers, texts, findings)
    own = mapping.cut.own_clocks and len(paths) > 1
    if own and len(paths) != len(recording.files):
        expected = f"as many files as of the taxels ({len(recording.files)})"
        findings.error(f"{entry.place} file", expected, len(paths))
    findings.raise_errors()
    clock = read_clock(tables, entry.time, entry.form, findings, own_clocks=own, slow=True)
    files = [
        {q.target: q.column(table.rows, table.text, table.numbers)[rows] for q in quantities}
        for table, rows in zip(tables, clock.rows, strict=True)
    ]
    findings.raise_errors()
    groups = [[i] for i in range(len(files))] if own else [[*range(len(files))]]
    columns: dict[str, list[Column]] = {q.target: [] for q in quantities}
    clocks: list[JoinedClock] = []
    shared = [clock for clock in recording.clocks if clock.name == entry.form.clock]
    for number, group in enumerate(groups):
        rows = recording.part == number if own else np.ones(len(recording), dtype=bool)
        times = np.concatenate([clock.times_s[i] for i in group])
        order = np.argsort(times, kind="stable")
        held = {name: np.concatenate([files[i][name] for i in group])[order] for name in columns}
        ours, times, note = recording.columns["time_s"][rows], times[order], ""
        if "day" in (kind, clock.kind):  # one of the two has no date, and they start at most half a day apart
            times, note = times + DAY_S * np.rint((ours[0] - times[0]) / DAY_S), " (of the same day)"
        if shared:
            aligned = replace(shared[number], name=entry.name)
        else:
            aligned = _aligned(entry, mapping, ours, recording.counts[rows], times, held, note, findings)
        onto = aligned.onto(times)
        clocks.append(aligned)
        for q in quantities:
            columns[q.target].append(_onto(q, entry, onto, held[q.target], ours))
    return replace(
        recording,
        columns={**recording.columns, **{name: np.concatenate(parts) for name, parts in columns.items()}},
        notes=(*recording.notes, *clock.notes),
        clocks=(*recording.clocks, *clocks),
    )


def join_by_press(
    recording: Recording,
    entry: JoinedFile,
    paths: Sequence[Path],
    quantities: Sequence[Quantity],
    findings: Findings,
) -> Recording:
    """Return the recording with the columns of a table with one row per press; rows of no press have force 0.

    Raises:
        InputError: the table cannot be read, or lacks a number or has it twice.
    """
    numbers, texts = source_columns(quantities)
    numbers = [*dict.fromkeys((*numbers, entry.form.press))]
    tables = read_source_tables(paths, entry.form, numbers, texts, findings)
    findings.raise_errors()
    keys = pd.Index(np.concatenate([table.numbers(entry.form.press) for table in tables]))
    parts = [[q.column(table.rows, table.text, table.numbers) for table in tables] for q in quantities]
    place, ours = f'{tables[0].sheet.file}, column "{entry.form.press}"', recording.columns["press"]
    if twice := keys[keys.duplicated()].unique().tolist():
        findings.error(place, "each number once", f"{listed(twice[:6], len(twice))} again")
        findings.raise_errors()
    row, numbered = keys.get_indexer(pd.Index(ours)), np.isfinite(ours) & (ours >= 0)
    if missing := np.unique(ours[(row < 0) & numbered]).tolist():
        findings.error(place, "the number of every press", f"none for {listed(missing[:6], len(missing))}")
    findings.raise_errors()
    columns = dict(recording.columns)
    for q, part in zip(quantities, parts, strict=True):
        values = np.concatenate(part)
        nothing = "" if values.dtype == object else 0.0 if q.target == "force_n" else np.nan
        columns[q.target] = np.where(row < 0, nothing, values[row]) if len(values) else ours
    return replace(recording, columns=columns)


def _aligned(
    entry: JoinedFile, mapping: Mapping, ours: FloatArray, images: FloatArray, times: FloatArray,
    held: Map[str, Column], note: str, findings: Findings,
) -> JoinedClock:  # fmt: skip
    """Return the alignment of a file's clock with that of the taxels."""
    own = [q for q in mapping.quantities if q.topic == entry.name and not q.is_text]
    numbers = {q.target: held[q.target] for q in own if not targets.is_whole(q.target)}
    if "force_n" in numbers:
        numbers = {"force_n": numbers["force_n"]}
    if isinstance(entry.form.offset_s, str):
        try:
            return _estimated(entry.name, mapping, ours, images, times, numbers, entry.form.within_s)
        except NoOffsetError as error:
            others = [other.name for other in mapping.joined if other.name != entry.name]
            shares = f', or, if it is that of {others[0]}, set clock = "{others[0]}"' if others else ""
            expected, fix = "an offset that the recordings determine", f"Give it in seconds{shares}."
            raise input_error(f"{entry.place} offset_s", expected, error, fix) from error
    onto = times + entry.form.offset_s
    if onto[-1] < ours[0] or onto[0] > ours[-1]:
        zone = ZONE_S * float(np.rint((ours[0] - onto[0]) / ZONE_S))
        meets = onto[-1] + zone > ours[0] and onto[0] + zone < ours[-1] and abs(zone) <= DAY_S / 2
        close = f" (for a time zone, {entry.form.offset_s + zone:g})" if zone and meets else ""
        raise input_error(
            entry.place, f"times within those of the taxels, {ours[0]:.12g} s to {ours[-1]:.12g} s",
            f"{onto[0]:.12g} s to {onto[-1]:.12g} s{note}",
            f"Their clocks differ: give offset_s, the time to add to its stamps{close}, or set "
            'offset_s = "estimate".',
        )  # fmt: skip
    found = None
    for within_s in (np.inf, LOOKED_S):
        inside = (ours >= onto[0] - within_s) & (ours <= onto[-1] + within_s)
        with suppress(ValueError):  # also NoOffsetError
            found = _estimated(entry.name, mapping, ours[inside], images[inside], onto, numbers, within_s)
            break
    if found is None:
        return JoinedClock(entry.name, entry.form.offset_s)
    ends = onto[[0, -1]]
    first, last = (found.onto(ends) - ends).tolist()
    allowed = max(APART_SIGMAS * found.sigma_s, APART_STEPS * (usual_step(ours) + usual_step(times)))
    if max(abs(first), abs(last)) > allowed:
        runs = f"{found.offset_s:+.3g} ± {found.sigma_s:.2g} s"
        better = f'{entry.form.offset_s + found.offset_s:.6g}, or "estimate"'
        if abs(last - first) > allowed:
            runs, better = f"{first:+.3g} s at the beginning and {last:+.3g} s at the end", '"estimate"'
        findings.warn(
            f"{entry.place} offset_s", f"the clock of the taxels, with {entry.form.offset_s:g} s added",
            f"{found.by} correlates best with the taxels {runs} later",
            f"Is the skin that slow, or do the clocks differ? If the clocks differ: offset_s = {better}.",
        )  # fmt: skip
    return replace(found, offset_s=entry.form.offset_s, sigma_s=np.nan, rate=0.0, estimated=False)


def _estimated(
    name: str, mapping: Mapping, ours: FloatArray, images: FloatArray, times: FloatArray,
    numbers: Map[str, FloatArray], within_s: float,
) -> JoinedClock:  # fmt: skip
    """Return the offset by the correlation with the taxels; where nothing follows them, by where the images lie."""
    places = {target: column for target, column in numbers.items() if target in POSITION}
    try:
        return estimate_offset(name, ours, images, times, numbers, within_s)
    except NoOffsetError:
        if not places:
            raise
    return estimate_offset_by_place(name, ours, images, mapping.centres_m, times, places, within_s)


def _onto(
    quantity: Quantity, entry: JoinedFile, times: FloatArray, column: Column, ours: FloatArray
) -> Column:
    age = STEPS_OLD * usual_step(times) if entry.form.max_age_s is None else entry.form.max_age_s
    if column.dtype != object:
        # Where the file has no value in a row, the row before is valid for as long as it may.
        given = np.isfinite(column)
        times, column = times[given], column[given]
    return resampled(times, column, ours, quantity.resampling(entry.form.resample), age)
