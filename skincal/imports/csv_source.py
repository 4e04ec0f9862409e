"""Reader of text files, and of tables of other formats: a recording in SI, with every bad cell reported."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from skincal.dataset.findings import Findings
from skincal.imports import targets
from skincal.imports.join import assigned, join_file
from skincal.imports.mapping import CsvSource, Mapping, Quantity
from skincal.imports.other_file import explain_missing
from skincal.imports.recording import Dropped, ReadFile, Recording
from skincal.imports.source_table import read_source_table
from skincal.imports.stamps import read_clock
from skincal.imports.text_table import TextTable
from skincal.imports.values import is_text, quantity_values


def read_csv_files(mapping: Mapping, files: Sequence[Path], findings: Findings) -> Recording | None:
    """Read files by a mapping.

    Args:
        mapping: the mapping.
        files: the files, in the order of the session, those of ``[files]`` among them.
        findings: collects the errors.

    Returns:
        One row per row of the files with the taxels; None if a file cannot be read at all.

    Raises:
        InputError: a file of ``[files]`` is missing.
    """
    form = mapping.source
    assert isinstance(form, CsvSource)
    paths, others = assigned(mapping.joined, files, mapping.path.parent)
    own = [q for q in mapping.quantities if not q.topic]
    texts = {name for q in own for name in q.sources if is_text(q)}
    numbers = [name for q in own for name in q.sources if not is_text(q)]
    numbers += list(dict.fromkeys(mapping.taxels.names))
    tables = [read_source_table(path, form, numbers, texts, findings) for path in paths]
    if len(paths) > 1 and any(table is None for table in tables):
        explain_missing(paths, form, mapping, findings)
    read = [table for table in tables if table is not None]
    if len(read) < len(paths) or not read:
        return None
    parts = [_recording(mapping, own, i, table) for i, table in enumerate(read)]
    if mapping.rows == targets.PRESSES:
        return _complete(joined(parts), mapping)
    time = mapping.quantity("time_s")
    clock = read_clock(read, time, form, findings, own_clocks=mapping.cut.own_clocks)
    parts = [part.select(rows) for part, rows in zip(parts, clock.rows, strict=True)]
    parts = [
        replace(part, columns={"time_s": times, **part.columns})
        for part, times in zip(parts, clock.times_s, strict=True)
    ]
    recording = replace(joined(parts), notes=clock.notes)
    for entry in mapping.joined:
        if findings.errors:
            return recording
        recording = join_file(recording, clock.kind, entry, others[entry.name], mapping, findings)
    if findings.errors:
        return recording
    return _complete(recording, mapping)


def joined(parts: Sequence[Recording]) -> Recording:
    """Return recordings joined one after the other."""
    names = list(parts[0].columns)
    return Recording(
        {name: np.concatenate([part.columns[name] for part in parts]) for name in names},
        np.concatenate([part.counts for part in parts]),
        np.concatenate([part.part for part in parts]),
        tuple(file for part in parts for file in part.files),
        summed([dropped for part in parts for dropped in part.dropped]),
    )


def summed(dropped: Sequence[Dropped]) -> tuple[Dropped, ...]:
    """Return the dropped samples, with equal reasons added up."""
    counts: dict[tuple[str, str], int] = {}
    for item in dropped:
        counts[item.what, item.why] = counts.get((item.what, item.why), 0) + item.count
    return tuple(Dropped(count, what, why) for (what, why), count in counts.items() if count)


def _recording(mapping: Mapping, own: Sequence[Quantity], part: int, table: TextTable) -> Recording:
    """Return one file; the clock of a time series is read separately, from all files together."""
    form = mapping.source
    assert isinstance(form, CsvSource)
    series = mapping.rows == targets.SERIES
    columns = {q.target: quantity_values(q, table) for q in own if not (series and q.target == "time_s")}
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
            missing = np.isnan(columns[quantity.target]) & _unreported(quantity, table)
            expected = f"a number ({quantity.target} is required in every row)"
            fix = "drop_incomplete = true in [csv] leaves such rows out."
            name = ", ".join(quantity.sources)
            table.sheet.bad_rows(name, missing, np.full(table.rows, np.nan), expected, fix)
    return recording


def _complete(recording: Recording, mapping: Mapping) -> Recording:
    """Return the recording without incomplete rows, of a joined file or where ``drop_incomplete`` is set."""
    form = mapping.source
    assert isinstance(form, CsvSource)
    kept = np.ones(len(recording), dtype=bool)
    dropped: list[Dropped] = []
    for quantity in mapping.quantities:
        if quantity.topic and _needed_of_joined(mapping, quantity):
            missing = np.isnan(recording.columns[quantity.target]) & kept
            why = f"no {quantity.target} from {quantity.topic} at their time (max_age_s in [files.{quantity.topic}])"
            dropped.append(Dropped(int(missing.sum()), "frame", why))
            kept &= ~missing
    if form.drop_incomplete:
        own = [q.target for q in mapping.quantities if not q.topic and _needed(mapping, q)]
        gaps = {name: np.isnan(recording.columns[name]) & kept for name in own}
        lost = np.logical_or.reduce([np.zeros(len(recording), dtype=bool), *gaps.values()])
        why = f"no value in a required column ({', '.join(name for name in gaps if gaps[name].any())})"
        dropped.append(Dropped(int(lost.sum()), "row", why))
        kept &= ~lost
    return recording if kept.all() else recording.select(kept, summed(dropped))


def _needed(mapping: Mapping, quantity: Quantity) -> bool:
    """Return whether a column needs a value in every row; a clock fills its own gaps."""
    if not quantity.sources or targets.is_text(quantity.target):
        return False
    if mapping.rows == targets.SERIES:
        return quantity.target == "force_n"
    needed = targets.required_targets(mapping.rows, positions=np.isfinite(mapping.meta.position.sigma_m))
    return quantity.target in (*needed, "press")


def _needed_of_joined(mapping: Mapping, quantity: Quantity) -> bool:
    return quantity.target in targets.required_targets(
        mapping.rows, positions=bool(np.isfinite(mapping.meta.position.sigma_m))
    )


def _unreported(quantity: Quantity, table: TextTable) -> NDArray[np.bool_]:
    """Return which rows hold no cell that has been reported as not a number."""
    bad = np.zeros(table.rows, dtype=bool)
    for name in quantity.sources:
        cells = table.text(name)
        if cells.dtype == object:
            bad |= np.array([cell != "" for cell in cells], dtype=bool)
    return ~bad
