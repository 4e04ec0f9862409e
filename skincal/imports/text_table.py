"""A text file in any layout as named columns, with the line number of each row."""

from __future__ import annotations

import codecs
import re
from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skincal.bounded import UnreadableError, parse_csv, read_bytes
from skincal.dataset.findings import SHOWN, Findings, Sheet, meant
from skincal.dataset.table_file import read_rows, report_ragged
from skincal.errors import first_of, text_of
from skincal.files import reason
from skincal.imports.mapping_file import CsvFormat
from skincal.imports.recording import BoolArray, FloatArray, IntArray

Column = NDArray[Any]

COMMENT = ("#", "%")

ELEMENT = re.compile(r"^(.+)\[\d+\]$")

GROUPED = re.compile(r"[+-]?[1-9]\d{0,2}(?:([.,'’_\s])\d{3})(?:\1\d{3})*([.,]\d+)?")
"""A number whose thousands are separated; one that begins with 0 is none."""

HEXADECIMAL = re.compile(r"0[xX][0-9a-fA-F]{1,16}")

WORD = re.compile(r"[^\d\s]*|.*#.*")
"""A cell that stands for no value, as ``-``, ``null``, ``N/A``, ``#N/A`` or ``1.#QNAN`` do."""

UTF_16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
"""First bytes of text in UTF-16, as spreadsheets and data loggers export it."""

MOST_NAMED, MOST_MISSING = 12, 3
"""Columns of a file that an error names, and missing ones that are reported one by one, not together."""

MOST_LOG_BYTES = 1 << 30
"""Largest size of a text file, which is read at once [byte]."""


class SourceSheet(Sheet):
    """Names of places in a file; ``lines`` holds the line number of each row, None without lines."""

    def __init__(self, findings: Findings, file: str, lines: IntArray | None) -> None:
        super().__init__(findings, file, None)
        self.lines = lines

    def rows(self, name: str, rows: ArrayLike, total: int | None = None) -> str:
        """Return the place of some rows (counted from 0) of a column, the first of ``total``, with their lines."""
        index = np.atleast_1d(np.asarray(rows))
        count = index.size if total is None else total
        lines = ["" if self.lines is None else f" (line {self.lines[row]})" for row in index[:SHOWN]]
        named = first_of((f"{row + 1}{line}" for row, line in zip(index, lines, strict=False)), SHOWN, count)
        return f'{self.file}, column "{name}", {"row" if count == 1 else "rows"} {named}'


class TextTable:
    """A text file that has been read: float64 columns where every cell is a number, else text."""

    def __init__(self, sheet: SourceSheet, columns: dict[str, Column], rows: int, form: CsvFormat) -> None:
        self.sheet = sheet
        self.rows = rows
        self._columns = columns
        self._form = form

    def numbers(self, name: str) -> FloatArray:
        """Return a column as numbers, NaN for empty cells; add an error for other texts and for inf."""
        column = self._columns.get(name)
        if column is None:
            return np.full(self.rows, np.nan)
        if column.dtype == object:
            values, bad = _parsed(column, self._form)
            self.sheet.bad_rows(name, bad, column, "a number", _format_hint(column, bad, self._form))
            return values
        self.sheet.bad_rows(name, np.isinf(column), column, "a finite number")
        return column

    def text(self, name: str) -> NDArray[Any]:
        """Return a column as text, '' for empty cells."""
        column = self._columns.get(name)
        return np.full(self.rows, "", dtype=object) if column is None else column


def read_text_table(
    path: Path, form: CsvFormat, numbers: Collection[str], texts: Collection[str], findings: Findings
) -> TextTable | None:
    """Read the required columns; None, with errors, if the file does not have this layout."""
    lines = text_lines(path, form, findings)
    if lines is None:
        return None
    names, kept = _header(path.name, form, lines, findings)
    if form.header and (again := [number for number, text in kept if text == lines[0][1]]):
        # A logger that was restarted goes on in the same file with another header.
        got = f"the same line again, in line {first_of(again)}"
        findings.note(path.name, "one header", got)
        kept = [(number, text) for number, text in kept if text != lines[0][1]]
    # The elements of a list in a cell are columns "name[0]", "name[1]", ….
    elements = {name: ELEMENT.sub(r"\1", name) for name in numbers if name not in names}
    lists = {name: column for name, column in elements.items() if column in names}
    types = {name: "number" for name in numbers if name not in lists}
    types |= dict.fromkeys((*texts, *lists.values()), "text")
    wanted = [*types]
    if not names or not check_columns(path.name, names, wanted, findings):
        return None
    body = "\n".join(" ".join(text.split()) if form.delimiter == "whitespace" else text for _, text in kept)
    numbered = np.array([number for number, _ in kept], dtype=np.int64)
    sheet = SourceSheet(findings, path.name, numbered)
    columns = _parse(sheet, body, form, names, types, numbered)
    if columns is None:
        return None
    columns |= _elements(sheet, columns, lists)
    return TextTable(sheet, columns, len(kept), form)


def _elements(sheet: SourceSheet, columns: dict[str, Column], lists: dict[str, str]) -> dict[str, Column]:
    """Return the elements of columns whose cells are lists of numbers; ``lists`` names the column of each element."""
    found: dict[str, Column] = {}
    split = {
        name: [re.findall(r"[^\s,;\[\]()]+", cell) for cell in columns[name].tolist()]
        for name in dict.fromkeys(lists.values())
    }
    for element, name in lists.items():
        cells, index = split[name], int(element[len(name) + 1 : -1])
        words = np.array([cell[index] if index < len(cell) else "" for cell in cells], dtype=object)
        values, bad = _parsed(words, CsvFormat())
        bad |= np.array([index >= len(cell) for cell in cells])
        if bad.any():
            sheet.bad_rows(name, bad, columns[name], f"a list of {len(cells[0])} numbers")
            break
        found[element] = values
    return found


def column_names(path: Path, form: CsvFormat) -> list[str]:
    """Return the column names of a text file; none without a header."""
    lines = text_lines(path, form, Findings())
    return _header(path.name, form, lines, Findings())[0] if lines else []


def text_lines(
    path: Path, form: CsvFormat, findings: Findings, *, blank: bool = False
) -> list[tuple[int, str]] | None:
    """Return the lines that are not skipped, not comments and, unless ``blank``, not empty, with their numbers."""
    utf_8 = form.encoding.lower() in ("utf-8", "utf8")
    try:
        content = read_bytes(path, MOST_LOG_BYTES)
        encoding = ("utf-16" if content.startswith(UTF_16) else "utf-8-sig") if utf_8 else form.encoding
        text = content.decode(encoding)
    except UnreadableError as error:
        fix = "Cut it into several files, which are read one after the other."
        findings.error(path.name, error.expected, error.got, fix)
        return None
    except OSError as error:
        findings.error(str(path), "a text file", reason(error))
        return None
    except UnicodeDecodeError as error:
        fix = 'Set encoding in [csv], to "latin-1" or "utf-16" perhaps.'
        findings.error(path.name, f"text in {form.encoding}", f"byte {error.start}: {error.reason}", fix)
        return None
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    numbered = enumerate(lines[form.skip_rows :], start=form.skip_rows + 1)
    if not blank:
        numbered = ((number, line) for number, line in numbered if line.strip())
    comment = form.comment
    return [(n, line) for n, line in numbered if not (comment and line.lstrip().startswith(comment))]


def _header(
    file: str, form: CsvFormat, lines: list[tuple[int, str]], findings: Findings
) -> tuple[list[str], list[tuple[int, str]]]:
    """Return the names of the columns (numbers from 1 without a header), and the lines of the rows."""
    if not lines:
        findings.error(file, "a header line and rows" if form.header else "rows", "nothing")
        return [], []
    first = lines[0][1]
    try:
        cells = first.split() if form.delimiter == "whitespace" else parse_csv(first, form.delimiter)[0]
    except UnreadableError as error:
        findings.error(f"{file}, line {lines[0][0]}", error.expected, error.got)
        return [], []
    names = [cell.strip() for cell in cells] if form.header else [str(i + 1) for i in range(len(cells))]
    rows = lines[(1 if form.header else 0) + form.skip_after_header :]
    # As numpy.savetxt and loggers write it.
    if form.header and len(names) > 1 and names[0].startswith(COMMENT):
        names[0] = names[0].lstrip("#% ")
        names = names if names[0] else names[1:]
    if names[-1] and rows and all(text.rstrip().endswith(form.delimiter) for _, text in rows):
        names = [*names, ""]  # rows end in a delimiter, and the header does not
    if not rows:
        findings.error(file, "at least one row below the header", "none")
    return names if rows else [], rows


def check_columns(
    file: str, names: Collection[str], wanted: Sequence[str], findings: Findings, hint: str = ""
) -> bool:
    """Return whether a file has some columns, each once; add errors that name those it has, and the advice ``hint``."""
    missing = [name for name in wanted if name not in names]
    shown = ", ".join(f'"{name}"' for name in [*names][:MOST_NAMED]) or "none"
    more = f", … ({len(names)} in all)" if len(names) > MOST_NAMED else ""
    others = f" and {len(missing) - 1} more" if len(missing) > MOST_MISSING else ""
    for name in missing[:1] if others else missing:
        expected = f'a column "{name}"{others}'
        findings.error(file, expected, f"the columns {shown}{more}", meant(name, names, hint))
    times = Counter([*names])
    doubled = [name for name in wanted if times[name] > 1]
    for name in doubled:
        findings.error(f'{file}, column "{name}"', "each column once", f"{times[name]} of that name")
    return not missing and not doubled


def _parse(
    sheet: SourceSheet, body: str, form: CsvFormat, names: list[str], types: dict[str, str], lines: IntArray
) -> dict[str, Column] | None:  # fmt: skip
    import pyarrow as arrow  # pyright: ignore[reportMissingTypeStubs]
    import pyarrow.csv as arrow_csv  # pyright: ignore[reportMissingTypeStubs]

    pa, pcsv = cast("Any", arrow), cast("Any", arrow_csv)
    # Only a single thread knows the line numbers of bad rows.
    options = pcsv.ReadOptions(column_names=names, use_threads=False, block_size=1 << 24)

    def read(number: Any) -> tuple[Any, list[Any]]:
        cells = pcsv.ConvertOptions(
            column_types={name: number if kind == "number" else pa.string() for name, kind in types.items()},
            include_columns=[*types], null_values=[*form.blanks], strings_can_be_null=True,
            decimal_point=form.decimal,
        )  # fmt: skip
        delimiter = " " if form.delimiter == "whitespace" else form.delimiter
        return read_rows(pa.BufferReader(body.encode("utf-8")), options, cells, delimiter)

    try:
        try:
            table, ragged = read(pa.float64())
        except pa.ArrowInvalid:
            table, ragged = read(pa.string())
    except pa.ArrowException as error:
        sheet.findings.error(sheet.file, "rows of cells", text_of(error))
        return None
    if ragged:
        fix = "Was the file cut short, or are there lines to skip (skip_rows, skip_after_header, comment)?"
        numbered = [int(lines[row.number - 1]) for row in ragged]
        report_ragged(sheet.file, ragged, numbered, sheet.findings, fix)
        return None
    if table.num_rows != len(lines):
        got = f"{table.num_rows} rows in {len(lines)} lines"
        sheet.findings.error(sheet.file, "a row in every line", got, "Is there a quote that is not closed?")
        return None
    return {name: _column(table.column(name), types[name], form) for name in types}


def _column(column: Any, kind: str, form: CsvFormat) -> Column:
    if str(column.type) == "double":
        values = np.array(column.to_numpy(), dtype=np.float64)
        # A number that stands for nothing may be written as -1, -1.0 or -1.00.
        marks, no_mark = _parsed(np.array(form.missing, dtype=object), replace(form, missing=()))
        values[np.isin(values, marks[np.isfinite(marks) & ~no_mark])] = np.nan
        return values
    cells = ["" if cell is None else str(cell).strip() for cell in column.to_pylist()]
    words = np.array(cells, dtype=object)
    if kind == "text":
        return words
    values, bad = _parsed(words, form)
    return words if bad.any() or np.isinf(values).any() else values


def _parsed(cells: NDArray[Any], form: CsvFormat) -> tuple[FloatArray, BoolArray]:
    """Return cells as numbers, NaN for those without a value, and which of them are not finite numbers."""
    decimal, blanks, spaces = form.decimal, form.blanks, form.thousands.isspace()
    values = np.full(len(cells), np.nan)
    bad = np.zeros(len(cells), dtype=bool)
    for i, cell in enumerate(cells):
        if cell in blanks:
            continue
        if form.thousands:
            cell = "".join(cell.split()) if spaces else cell.replace(form.thousands, "")
        if HEXADECIMAL.fullmatch(cell):
            values[i] = int(cell, 16)
            continue
        cell = cell.replace("\N{MINUS SIGN}", "-")
        try:
            values[i] = float(cell.replace(decimal, ".") if "." not in cell or decimal == "." else "no")
            bad[i] = bool(np.isinf(values[i]))
        except ValueError:
            bad[i] = True
    return values, bad


def _format_hint(cells: NDArray[Any], bad: BoolArray, form: CsvFormat) -> str:
    """Return the lines of ``[csv]`` with which the bad cells are numbers, or have no value; '' if there are none."""
    wrong, other = cells[bad].tolist(), "," if form.decimal == "." else "."
    quoted = " and quoted = true" if form.delimiter == other and not form.quoted else ""
    if len(words := sorted({*wrong})) <= MOST_MISSING and all(map(WORD.fullmatch, words)):
        listed = ", ".join(f'"{word}"' for word in (*form.missing, *words))
        return f"If they stand for no value, set missing = [{listed}] in [csv]."
    grouped = [found for cell in wrong if (found := GROUPED.fullmatch(cell))]
    whole = all(cell in form.blanks or cell.isdecimal() or form.decimal in cell for cell in cells[~bad])
    if len(grouped) == len(wrong) and len({found[1] for found in grouped}) == 1:
        mark = " " if grouped[0][1].isspace() else grouped[0][1]
        if mark == form.decimal:
            return f'Set decimal = "{other}"{quoted} and thousands = "{mark}" in [csv].'
        if mark != other or any(found[2] for found in grouped) or (whole and not bad.all()):
            return f'Set thousands = "{mark}" in [csv].'
    still_bad = _parsed(cells[bad][:SHOWN], replace(form, decimal=other))[1]
    return (
        f'Set decimal = "{other}"{quoted} in [csv].'
        if any(other in cell for cell in cells[bad][:SHOWN][~still_bad])
        else ""
    )
