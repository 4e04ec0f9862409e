"""Read and write one table, CSV or Parquet, as named columns, without knowledge of their meaning."""

from __future__ import annotations

import codecs
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from skincal.bounded import UnreadableError, check_table_size
from skincal.dataset.findings import SHOWN, Findings, Sheet, listed
from skincal.dataset.tables import LazyColumns
from skincal.errors import first_of, input_error, text_of
from skincal.files import check_input, open_input, reason
from skincal.model.arrays import BoolArray

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa

Column = NDArray[Any]
Opened = tuple[list[str], int, Mapping[str, Column], dict[str, str]]
"""Column names, number of rows and columns of a file, and types of the columns that hold lists, tables or bytes."""

MOST_ROWS_HELD = 1_000_000
"""Largest number of rows of a table that is held in memory: presses, draws, taxels."""

MOST_CELLS_HELD = 20_000_000
"""Largest number of cells of a table that is held in memory (160 MB); a larger one is read column by column on use."""

MOST_COLUMN_BYTES = 1 << 30
"""Largest uncompressed size of one column of a Parquet file: 10^7 texts of 100 letters."""

MOST_CSV_BYTES = 1 << 30
"""Largest size of a CSV file, which is read as a whole: 10^7 rows of 100 letters."""

CUT_SHORT = "Was it cut short while it was copied or written?"
SUFFIXES = (".csv", ".parquet")
_TEXTS = ("string", "large_string")

TEXT_COLUMNS = ("phase", "pose", "branch")
"""Columns that are text even if they look like numbers."""


@dataclass(frozen=True)
class RawTable:
    """A table as read from a file.

    Its columns are int64, float64, bool, or ``str`` as objects; ``others`` are the types of the columns that cannot be
    read, by name: lists, tables, bytes.
    """

    sheet: Sheet
    rows: int
    columns: Mapping[str, Column]
    others: Mapping[str, str] = field(default_factory=dict[str, str])

    @property
    def is_large(self) -> bool:
        """True if only the columns in use should be held in memory."""
        return self.rows * len(self.columns) > MOST_CELLS_HELD


def find_table(folder: Path, stem: str, findings: Findings) -> Path | None:
    """Return the file of a table, ``stem.csv`` or ``stem.parquet``; None if there is none."""
    found = [folder / f"{stem}{suffix}" for suffix in SUFFIXES if (folder / f"{stem}{suffix}").exists()]
    if len(found) > 1:
        got = " and ".join(path.name for path in found)
        findings.error(str(folder), f"one table of {stem}", got, "Remove one of them.")
    return found[0] if found else None


def read_table(path: Path, findings: Findings, *, most_rows: int = MOST_ROWS_HELD) -> RawTable | None:
    """Read a table; add an error and return None if the file is not a readable table.

    The columns of a Parquet file are read on use and not cached.
    """
    import pyarrow as pa

    is_csv = path.suffix == ".csv"
    sheet = Sheet(findings, path.name, 1 if is_csv else None)
    try:
        check_input(path, within=path.parent)
    except OSError as error:
        findings.error(path.name, "a table", reason(error))
        return None
    try:
        found = _read_csv(path, sheet) if is_csv else _open_parquet(path, sheet)
        if found is None:
            return None
        names, rows, columns, others = found
        check_table_size(rows, len(names), most_rows)
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        what = "a readable CSV file" if is_csv else "a whole Parquet file"
        findings.error(path.name, what, text_of(error).rstrip("."), CUT_SHORT)
        return None
    except UnreadableError as error:
        findings.error(path.name, error.expected, error.got)
        return None
    for name, count in Counter(names).items():
        if count > 1:
            fix = "Rename or remove the others."
            findings.error(sheet.column(name), "each column once", f"{count} of that name", fix)
    return RawTable(sheet, rows, columns, others)


def _open_parquet(path: Path, sheet: Sheet) -> Opened:
    """Return a Parquet file, whose columns are read on use."""
    import pyarrow.parquet as pq

    # Open the file here: Arrow assumes names in UTF-8 for any system encoding, and would block on a pipe.
    with open_input(path) as source, pq.ParquetFile(source) as file:
        rows, schema = file.metadata.num_rows, file.schema_arrow
        groups = [file.metadata.row_group(i) for i in range(file.metadata.num_row_groups)]
        for j in range(file.metadata.num_columns):
            size = sum(group.column(j).total_uncompressed_size for group in groups)
            if size > MOST_COLUMN_BYTES:
                expected = f"columns of at most {MOST_COLUMN_BYTES >> 20} MiB"
                raise UnreadableError(expected, f"one of {size >> 20} MiB")
    types = list(zip(schema.names, schema.types, strict=True))
    texts = [name for name, kind in types if str(kind) in _TEXTS]
    columns = LazyColumns(schema.names, partial(_parquet_column, path, file_state(path), rows, texts, sheet))
    return schema.names, rows, columns, {name: str(kind) for name, kind in types if not _is_single(kind)}


def _parquet_column(
    path: Path, state: tuple[int, ...], rows: int, texts: list[str], sheet: Sheet, name: str
) -> Column:
    """Return a column of a Parquet file; ``state`` is the state of the file when it was checked."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        if file_state(path) != state:
            raise UnreadableError("the file that was checked", "another one: it has been replaced; run again")
        # Read texts dictionary-encoded: a word that repeats a million times is stored once.
        with open_input(path) as source, pq.ParquetFile(source, read_dictionary=texts) as file:
            column = file.read(columns=[name], use_threads=False).column(name)
        if len(column) != rows:
            raise pa.ArrowInvalid(f"{len(column)} of {rows} rows in column {name}")
        return _to_numpy(column, sheet, name)
    except UnreadableError as error:
        raise input_error(str(path), error.expected, error.got) from None
    except (pa.ArrowException, KeyError, OSError, UnicodeDecodeError) as error:
        got = text_of(error).rstrip(".")
        raise input_error(str(path), "a whole Parquet file", got, CUT_SHORT) from None


def _is_single(kind: pa.DataType) -> bool:
    import pyarrow as pa

    if isinstance(kind, pa.DictionaryType):
        return _is_single(kind.value_type)
    types = pa.types
    single = types.is_primitive(kind) or types.is_null(kind) or types.is_decimal(kind)
    return single or str(kind) in _TEXTS


def file_state(path: Path) -> tuple[int, ...]:
    """Return inode, size and time of a file, which change when it is replaced."""
    stat = path.stat()
    return stat.st_ino, stat.st_size, stat.st_mtime_ns


def write_table(path: Path, columns: Mapping[str, Column] | pd.DataFrame) -> None:
    """Write columns to a table, CSV or Parquet by the suffix; floats are read back exactly, NaN as an empty cell."""
    import pyarrow as pa
    import pyarrow.csv as pcsv
    import pyarrow.parquet as pq

    table = pa.Table.from_arrays(
        [_arrow(column) for _, column in columns.items()], names=[*map(str, columns)]
    )
    with path.open("wb") as file:
        if path.suffix == ".parquet":
            pq.write_table(table, file)
            return
        file.write((",".join(map(_quoted, table.column_names)) + "\n").encode())
        pcsv.write_csv(table, file, pcsv.WriteOptions(include_header=False, quoting_style="needed"))


def _arrow(column: Any) -> pa.Array:
    """Return a column as an Arrow array, with NaN as null.

    Plain columns are converted from their bytes: ``pyarrow.array`` imports pandas, which takes as long as reading and
    writing a small dataset.
    """
    import pyarrow as pa

    values = np.ascontiguousarray(column) if isinstance(getattr(column, "dtype", None), np.dtype) else column
    kind = values.dtype.kind if isinstance(values, np.ndarray) else ""
    if kind == "U" or (kind == "O" and all(type(word) is str for word in values)):
        words = [word.encode() for word in values.tolist()]
        ends = np.cumsum([0, *map(len, words)])
        if ends[-1] < 1 << 31:
            content = pa.py_buffer(ends.astype(np.int32)), pa.py_buffer(b"".join(words))
            return pa.StringArray.from_buffers(len(words), *content)
    if kind == "b":
        return pa.Array.from_buffers(pa.bool_(), len(values), [None, _bits(values)])
    if kind and kind in "iuf":
        missing = np.isnan(values) if kind == "f" else np.zeros(0, dtype=np.bool_)
        parts = [_bits(~missing) if missing.any() else None, pa.py_buffer(values)]
        return pa.Array.from_buffers(pa.from_numpy_dtype(values.dtype), len(values), parts)
    return pa.array(column, from_pandas=True)


def _bits(flags: BoolArray) -> pa.Buffer:
    import pyarrow as pa

    return pa.py_buffer(np.packbits(flags, bitorder="little"))


def _read_csv(path: Path, sheet: Sheet) -> Opened | None:
    """Return the content of a CSV file; None, with an error added, if it is empty or not text."""
    import pyarrow as pa
    import pyarrow.csv as pcsv

    text = {name: pa.string() for name in TEXT_COLUMNS}
    cells = pcsv.ConvertOptions(column_types=text, timestamp_parsers=["never"])
    findings, state, size = sheet.findings, file_state(path), path.stat().st_size
    if size > MOST_CSV_BYTES:
        expected = f"a CSV file of at most {MOST_CSV_BYTES >> 20} MiB"
        raise UnreadableError(expected, "a larger one; write it as Parquet")
    if not size:
        findings.error(path.name, "a header line and rows", "an empty file", "Write it again.")
        return None
    if line := _other_bytes(path):
        fix = "Is it another kind of file, or of another encoding?"
        findings.error(f"{path.name}, {line}", "text in UTF-8", "other bytes", fix)
        return None
    with open_input(path) as source:
        table, ragged = read_rows(source, pcsv.ReadOptions(block_size=1 << 22), cells)
    if file_state(path) != state:
        raise UnreadableError("a file that stays as it is", "one that changed while it was read; run again")
    if ragged:
        # Only a single-threaded read gives the line numbers.
        with open_input(path) as source:
            options = pcsv.ReadOptions(use_threads=False, block_size=1 << 22)
            ragged = read_rows(source, options, cells)[1] or ragged
        fix = "Was the file cut short, or does a text hold a comma that is not quoted?"
        report_ragged(path.name, ragged, [row.number for row in ragged], findings, fix)
    names = table.column_names
    columns = {name: _to_numpy(table.column(i), sheet, name) for i, name in enumerate(names)}
    return names, table.num_rows, columns, {}


def read_rows(source: Any, options: Any, cells: Any, delimiter: str = ",") -> tuple[Any, list[Any]]:
    """Return the rows of a text table, and those with too few or too many cells, which are left out."""
    import pyarrow.csv as pcsv

    ragged: list[pcsv.InvalidRow] = []

    def skip(row: pcsv.InvalidRow) -> str:
        ragged.append(row)
        return "skip"

    parse = pcsv.ParseOptions(delimiter=delimiter, invalid_row_handler=skip)
    return pcsv.read_csv(source, options, parse, cells), ragged


def report_ragged(
    file: str, ragged: Sequence[Any], lines: Sequence[int], findings: Findings, fix: str
) -> None:
    """Add an error for rows with too few or too many cells, in lines of a file."""
    place = f"{file}, line {first_of(lines, SHOWN)}"
    got = f"{listed([row.actual_columns for row in ragged[:SHOWN]], len(ragged))} cells"
    findings.error(place, f"{ragged[0].expected_columns} cells as in the header", got, fix)


def _other_bytes(path: Path) -> str:
    """Return the line of the first bytes that are not UTF-8, or ''; the CSV reader would print a traceback."""
    decoder, line = codecs.getincrementaldecoder("utf-8")(), 1
    with open_input(path) as file:
        while True:
            block = file.read(1 << 20)
            try:
                line += decoder.decode(block, final=not block).count("\n")
            except UnicodeDecodeError as error:
                return f"line {line + error.object[: error.start].count(10)}"
            if not block:
                return ""


def _to_numpy(column: pa.ChunkedArray, sheet: Sheet, name: str) -> Column:
    """Return an Arrow column as an array; add an error for a type that is neither number nor text."""
    import pyarrow as pa

    kind = column.type
    if pa.types.is_dictionary(kind):
        if str(kind.value_type) not in _TEXTS:
            return _to_numpy(column.cast(kind.value_type), sheet, name)
        return _words(column)
    if pa.types.is_null(kind):
        return np.full(len(column), np.nan)
    if pa.types.is_integer(kind) and not column.null_count:
        return _plain(column).astype(np.int64, copy=False)
    if pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_decimal(kind):
        # A cast to the same type would import Arrow's compute functions.
        floats = column if kind == pa.float64() else column.cast(pa.float64(), safe=False)
        return _plain(floats).astype(np.float64, copy=False)
    if pa.types.is_boolean(kind) and not column.null_count:
        return column.to_numpy()
    try:
        texts = column if kind == pa.string() else column.cast(pa.string())
        return np.array([word or "" for word in texts.to_pylist()], dtype=object)
    except (pa.ArrowException, UnicodeDecodeError):
        sheet.findings.error(sheet.column(name), "single numbers or texts", kind, "Remove the column.")
        return np.full(len(column), "", dtype=object)


def _words(column: pa.ChunkedArray) -> Column:
    """Return a dictionary-encoded column of texts as an array of objects, '' for null, without pandas."""
    import pyarrow as pa

    column = column.unify_dictionaries()
    if not column.num_chunks:
        return np.empty(0, dtype=object)
    words = [*(word or "" for word in column.chunk(0).dictionary.to_pylist()), ""]
    places = _plain(pa.chunked_array([chunk.indices for chunk in column.chunks]))
    return np.array(words, dtype=object)[np.nan_to_num(places, nan=-1).astype(np.int64)]


def _plain(column: pa.ChunkedArray) -> Column:
    """Return a column of numbers as an array, NaN for null, without pandas, which ``to_numpy`` would import."""
    parts = [_numbers(chunk) for chunk in column.chunks]
    return parts[0] if len(parts) == 1 else np.concatenate(parts) if parts else column.to_numpy()


def _numbers(chunk: pa.Array) -> Column:
    if not chunk.null_count:
        return np.from_dlpack(chunk)
    valid, values = chunk.buffers()
    rows = slice(chunk.offset, chunk.offset + len(chunk))
    present = np.unpackbits(np.frombuffer(valid, np.uint8), bitorder="little")[rows].astype(np.bool_)
    return np.where(present, np.frombuffer(values, chunk.type.to_pandas_dtype())[rows], np.nan)


def _quoted(name: str) -> str:
    return '"' + name.replace('"', '""') + '"' if any(c in name for c in ',"\n') else name
