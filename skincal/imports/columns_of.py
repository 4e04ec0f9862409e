"""Selection of the columns that a mapping needs from a file of arrays or frames."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skincal.dataset.findings import Findings, did_you_mean
from skincal.imports.text_table import SourceSheet, TextTable

Columns = dict[str, NDArray[Any]]
"""One-dimensional columns by name; their lengths may differ."""

SHOWN = 12


def chosen(
    file: str, columns: Columns, numbers: Collection[str], texts: Collection[str], decimal: str, findings: Findings,
    lines: NDArray[np.int64] | None = None, hint: str = "",
) -> TextTable | None:  # fmt: skip
    """Return a table of the required columns; None, with errors, if some are missing or differ in length."""
    wanted = [*dict.fromkeys((*numbers, *texts))]
    # MATLAB's structures have slashes in files of version 7.3, and dots in older ones.
    dotted = {name.replace("/", "."): column for name, column in columns.items()}
    columns = columns | {
        name: dotted[name.replace("/", ".")]
        for name in wanted
        if name not in columns and name.replace("/", ".") in dotted
    }
    if missing := [name for name in wanted if name not in columns]:
        shown = ", ".join(f'"{name}"' for name in [*columns][:SHOWN]) or "none"
        more = f", … ({len(columns)} in all)" if len(columns) > SHOWN else ""
        close = did_you_mean(missing[0], columns)
        others = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
        fix = f'Did you mean "{close}"?' if close else hint
        findings.error(file, f'a column "{missing[0]}"{others}', f"the columns {shown}{more}", fix)
        return None
    sizes = {len(columns[name]) for name in wanted}
    if len(sizes) > 1:
        got = ", ".join(f"{name}: {len(columns[name])}" for name in wanted[:SHOWN])
        fix = "Columns of another length have their own clock: add the file to [files] as well."
        findings.error(file, "columns of one length", got, fix)
        return None
    rows = sizes.pop() if sizes else max((len(column) for column in columns.values()), default=0)
    cells = {name: _column(columns[name], text=name in texts) for name in wanted}
    return TextTable(SourceSheet(findings, file, lines), cells, rows, decimal)


def _column(column: NDArray[Any], *, text: bool) -> NDArray[Any]:
    if column.dtype.kind in "biuf" and not text:
        return column.astype(np.float64)
    if column.dtype.kind == "M":
        column = np.datetime_as_string(column)
    return np.array([_word(cell) for cell in column], dtype=object)


def _word(cell: object) -> str:
    if isinstance(cell, bytes):
        return cell.decode(
            errors="backslashreplace"
        )  # said of it later, where a number or a date is expected
    return "" if cell is None else str(cell)
