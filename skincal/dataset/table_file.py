"""Reads and writes one table, CSV or Parquet, as named columns; what they mean is not known here."""

from __future__ import annotations

import codecs
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from skincal.dataset.findings import SHOWN, Findings, Sheet, listed
from skincal.files import check_input, reason

if TYPE_CHECKING:
    import pyarrow as pa

Column = NDArray[Any]

SUFFIXES = (".csv", ".parquet")
TEXT_COLUMNS = ("phase", "pose", "branch")
"""Columns that are text even where they look like numbers."""


@dataclass(frozen=True)
class RawTable:
    """A table as read: each column holds int64, float64, bool or, as objects, ``str``."""

    sheet: Sheet
    rows: int
    columns: Mapping[str, Column]


def find_table(folder: Path, stem: str, findings: Findings) -> Path | None:
    """The file of a table: ``stem.csv`` or ``stem.parquet``; None where there is none."""
    found = [folder / f"{stem}{suffix}" for suffix in SUFFIXES if (folder / f"{stem}{suffix}").exists()]
    if len(found) > 1:
        findings.error(
            str(folder), f"one table of {stem}", " and ".join(p.name for p in found), "Remove one of them."
        )
    return found[0] if found else None


def read_table(path: Path, findings: Findings) -> RawTable | None:
    """Reads a table; adds an error and returns None where the file cannot be read as one."""
    import pyarrow as pa

    reader = _read_csv if path.suffix == ".csv" else _read_parquet
    try:
        check_input(path, within=path.parent)
    except OSError as error:
        findings.error(path.name, "a table", reason(error))
        return None
    try:
        table = reader(path, findings)
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        what = "a readable CSV file" if path.suffix == ".csv" else "a whole Parquet file"
        got = " ".join(str(error).split())[:200].rstrip(".")
        findings.error(path.name, what, got, "Was it cut short while it was copied or written?")
        return None
    if table is None:
        return None
    sheet = Sheet(findings, path.name, 1 if path.suffix == ".csv" else None)
    doubled = sorted({name for name in table.column_names if table.column_names.count(name) > 1})
    for name in doubled:
        findings.error(
            sheet.column(name),
            "each column once",
            f"{table.column_names.count(name)} of that name",
            "Rename or remove the others.",
        )
    columns = {name: _to_numpy(table.column(i)) for i, name in enumerate(table.column_names)}
    return RawTable(sheet, table.num_rows, columns)


def write_table(path: Path, columns: Mapping[str, Column]) -> None:
    """Writes columns to a table, CSV or Parquet after the suffix; floats come back exactly.

    Raises:
        OSError: the disk is full, or not writable.
    """
    import pyarrow as pa

    arrays = [_to_arrow(column) for column in columns.values()]
    table = pa.Table.from_arrays(arrays, names=list(columns))
    if path.suffix == ".parquet":
        import pyarrow.parquet as pq

        pq.write_table(table, path)
        return
    import pyarrow.csv as pcsv

    with path.open("wb") as file:
        file.write((",".join(_quoted(name) for name in columns) + "\n").encode())
        pcsv.write_csv(table, file, pcsv.WriteOptions(include_header=False, quoting_style="needed"))


def _read_parquet(path: Path, findings: Findings) -> pa.Table:
    import pyarrow.parquet as pq

    return pq.ParquetFile(path).read()


def _read_csv(path: Path, findings: Findings) -> pa.Table | None:
    import pyarrow as pa
    import pyarrow.csv as pcsv

    text = {name: pa.string() for name in TEXT_COLUMNS}
    bad: list[pcsv.InvalidRow] = []

    def skip(row: pcsv.InvalidRow) -> str:
        bad.append(row)
        return "skip"

    def read(threads: bool) -> pa.Table:
        return pcsv.read_csv(
            path,
            pcsv.ReadOptions(use_threads=threads, block_size=1 << 22),
            pcsv.ParseOptions(invalid_row_handler=skip),
            pcsv.ConvertOptions(column_types=text, timestamp_parsers=["never"]),
        )

    if not path.stat().st_size:
        findings.error(path.name, "a header line and rows", "an empty file", "Write it again.")
        return None
    if not _begins_as_text(path):
        findings.error(
            path.name, "text in UTF-8", "other bytes", "Is it another kind of file, or of another encoding?"
        )
        return None
    table = read(threads=True)
    if bad:
        # Only a single thread knows the line numbers.
        bad.clear()
        table = read(threads=False)
        _report_ragged(path.name, bad, findings)
    return table


def _begins_as_text(path: Path) -> bool:
    """Whether the first bytes are UTF-8; the reader of CSV files prints a traceback for rows that are not."""
    with path.open("rb") as file:
        try:
            codecs.getincrementaldecoder("utf-8")().decode(file.read(1 << 16))
        except UnicodeDecodeError:
            return False
    return True


def _report_ragged(file: str, bad: Sequence[Any], findings: Findings) -> None:
    lines = [str(row.number) for row in bad[:SHOWN]]
    more = f" and {len(bad) - SHOWN} more" if len(bad) > SHOWN else ""
    findings.error(
        f"{file}, line {', '.join(lines)}{more}",
        f"{bad[0].expected_columns} cells as in the header",
        f"{listed([row.actual_columns for row in bad[:SHOWN]], len(bad))} cells",
        "Was the file cut short, or does a text hold a comma that is not quoted?",
    )


def _to_numpy(column: pa.ChunkedArray) -> Column:
    import pyarrow as pa
    import pyarrow.compute as pc

    kind = column.type
    if pa.types.is_dictionary(kind):
        column, kind = column.cast(kind.value_type), kind.value_type
    if pa.types.is_null(kind):
        return np.full(len(column), np.nan)
    if pa.types.is_integer(kind) and not column.null_count:
        return column.to_numpy().astype(np.int64, copy=False)
    if pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_decimal(kind):
        return column.cast(pa.float64(), safe=False).to_numpy().astype(np.float64, copy=False)
    if pa.types.is_boolean(kind) and not column.null_count:
        return column.to_numpy()
    if not (pa.types.is_nested(kind) or pa.types.is_binary(kind)):
        column = pc.fill_null(column.cast(pa.string()), "")
    return np.array(column.to_pylist(), dtype=object)


def _to_arrow(column: Column) -> pa.Array:
    import pyarrow as pa

    if column.dtype == object:
        return pa.array(column.tolist())
    # NaN is written as an empty cell: not measured.
    return pa.array(column, from_pandas=True)


def _quoted(name: str) -> str:
    return '"' + name.replace('"', '""') + '"' if any(c in name for c in ',"\n') else name
