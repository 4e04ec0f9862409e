"""Text files to a recording: every mapped column converted to SI, every bad cell named."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from skincal.dataset.findings import Findings
from skincal.imports import targets, units
from skincal.imports.mapping import CsvFormat, Mapping, Quantity
from skincal.imports.recording import Column, Dropped, FloatArray, ReadFile, Recording
from skincal.imports.text_table import TextTable, read_text_table


def read_csv_files(mapping: Mapping, files: Sequence[Path], findings: Findings) -> Recording | None:
    """Reads text files after a mapping.

    Args:
        mapping: what their columns mean.
        files: the files, in the order of the session.
        findings: where errors go.

    Returns:
        All of them as one recording; None where one cannot be read at all.
    """
    form = mapping.source
    assert isinstance(form, CsvFormat)
    texts = {name for q in mapping.quantities for name in q.sources if _is_text(q)}
    numbers = [name for q in mapping.quantities for name in q.sources if not _is_text(q)]
    numbers += [mapping.taxels.names[j] for j in mapping.taxels.order]
    tables = [read_text_table(path, form, numbers, texts, findings) for path in files]
    parts = [_recording(mapping, i, table) for i, table in enumerate(tables) if table is not None]
    return joined(parts) if len(parts) == len(files) and parts else None


def joined(parts: Sequence[Recording]) -> Recording:
    """Recordings one after the other."""
    names = list(parts[0].columns)
    return Recording(
        {name: np.concatenate([part.columns[name] for part in parts]) for name in names},
        np.concatenate([part.counts for part in parts]),
        np.concatenate([part.part for part in parts]),
        tuple(file for part in parts for file in part.files),
        summed([dropped for part in parts for dropped in part.dropped]),
    )


def summed(dropped: Sequence[Dropped]) -> tuple[Dropped, ...]:
    """What was dropped for the same reason, added up."""
    counts: dict[tuple[str, str], int] = {}
    for item in dropped:
        counts[item.what, item.why] = counts.get((item.what, item.why), 0) + item.count
    return tuple(Dropped(count, what, why) for (what, why), count in counts.items() if count)


def _is_text(quantity: Quantity) -> bool:
    return targets.is_text(quantity.target) or quantity.unit.name == units.DATETIME


def _recording(mapping: Mapping, part: int, table: TextTable) -> Recording:
    form = mapping.source
    assert isinstance(form, CsvFormat)
    columns = {q.target: _values(q, table) for q in mapping.quantities}
    raw = {name: table.numbers(name) for name in dict.fromkeys(mapping.taxels.names)}
    images = np.column_stack([raw[name] for name in mapping.taxels.names])
    recording = Recording(
        columns,
        mapping.taxels.counts(images),
        np.full(table.rows, part, dtype=np.int64),
        (ReadFile(table.sheet.file, table.rows),),
    )
    gaps = {q.target: np.isnan(columns[q.target]) for q in mapping.quantities if _needed(mapping, q)}
    if form.drop_incomplete:
        incomplete = np.logical_or.reduce([np.zeros(table.rows, dtype=bool), *gaps.values()])
        why = f"nothing in a column that is needed ({', '.join(name for name in gaps if gaps[name].any())})"
        lost = int(incomplete.sum())
        return recording.select(~incomplete, (Dropped(lost, "row", why),) if lost else ())
    for quantity in mapping.quantities:
        if quantity.target in gaps:
            name = ", ".join(quantity.sources)
            missing = gaps[quantity.target] & _unreported(quantity, table)
            expected = f"a number ({quantity.target} is needed in every row)"
            fix = "drop_incomplete = true in [csv] leaves such rows out."
            table.sheet.bad_rows(name, missing, np.full(table.rows, np.nan), expected, fix)
    return recording


def _needed(mapping: Mapping, quantity: Quantity) -> bool:
    """Whether a column needs a value in every row."""
    if not quantity.sources or targets.is_text(quantity.target):
        return False
    if mapping.rows == targets.SERIES:
        return quantity.target in ("time_s", "force_n")
    needed = targets.required_targets(mapping.rows, positions=np.isfinite(mapping.meta.position.sigma_m))
    return quantity.target in (*needed, "press")


def _unreported(quantity: Quantity, table: TextTable) -> NDArray[np.bool_]:
    """Which rows hold no cell that has been reported already as no number."""
    bad = np.zeros(table.rows, dtype=bool)
    for name in quantity.sources:
        cells = table.text(name)
        if cells.dtype == object:
            bad |= np.array([cell != "" for cell in cells], dtype=bool)
    return ~bad


def _values(quantity: Quantity, table: TextTable) -> Column:
    if quantity.constant is not None:
        return constant(quantity.constant, table.rows)
    if targets.is_text(quantity.target):
        return np.array(
            [quantity.words.get(word, word) for word in table.text(quantity.sources[0])], dtype=object
        )
    if quantity.unit.name == units.DATETIME:
        return _dates(quantity.sources[0], table)
    parts = [quantity.si(table.numbers(name)) for name in quantity.sources]
    return parts[0] if len(parts) == 1 else length(parts)


def constant(value: float | str, rows: int) -> Column:
    """A column that holds the same in every row."""
    return np.full(rows, value, dtype=object if isinstance(value, str) else np.float64)


def length(parts: Sequence[FloatArray]) -> FloatArray:
    """Length of a vector from its components, shape (rows,)."""
    return np.linalg.norm(np.column_stack(parts), axis=1)


def _dates(name: str, table: TextTable) -> FloatArray:
    """Dates and times as seconds since 1970; those without a zone are all of one, which does not matter."""
    cells = table.text(name)
    seconds, bad = np.full(table.rows, np.nan), np.zeros(table.rows, dtype=bool)
    for i, cell in enumerate(cells):
        try:
            moment = datetime.fromisoformat(cell) if cell else None
        except ValueError:
            bad[i] = True
            continue
        if moment is not None:
            seconds[i] = (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()
    table.sheet.bad_rows(name, bad, cells, "a date and time like 2026-11-20 12:00:00.250")
    return seconds
