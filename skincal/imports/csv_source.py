"""Reader of text files, and of tables of other formats: a recording in SI, with every bad cell reported."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from skincal.dataset.findings import Findings
from skincal.imports import targets
from skincal.imports.join import assigned, join_file
from skincal.imports.mapping import Mapping, Quantity, source_columns
from skincal.imports.mapping_file import CsvFormat, CsvSource
from skincal.imports.recording import ReadFile, Recording, joined
from skincal.imports.source_table import read_source_tables
from skincal.imports.stamps import read_clock
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
    timed = {"time_s"} if mapping.rows == targets.SERIES else set[str]()
    columns = {
        q.target: q.column(table.rows, table.text, table.numbers) for q in own if q.target not in timed
    }
    raw = {name: table.numbers(name) for name in dict.fromkeys(mapping.taxels.names)}
    images = np.column_stack([raw[name] for name in mapping.taxels.names])
    recording = Recording(
        columns,
        mapping.taxels.counts(images),
        np.full(table.rows, part, dtype=np.int64),
        (ReadFile(table.sheet.file, table.rows),),
    )
    if form.drop_incomplete:
        return recording
    for quantity in own:
        if quantity.target in columns and _needed(mapping, quantity):
            cells = [table.text(name) for name in quantity.sources]
            # Cells that are not numbers have been reported.
            reported = [column != "" for column in cells if column.dtype == object]
            missing = np.isnan(columns[quantity.target]) & ~np.any(reported or [[False]], axis=0)
            expected = f"a number ({quantity.target} is required in every row)"
            fix = "drop_incomplete = true in [csv] leaves such rows out."
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
    """Return whether a column needs a value in every row; a clock fills its own gaps."""
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
