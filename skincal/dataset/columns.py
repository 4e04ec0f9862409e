"""Checked access to the columns of one table: types, missing columns, permitted NaN."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skincal.bounded import LARGEST
from skincal.covariates import ANY, COLUMNS, NOT_NEGATIVE, POSITIVE, TEXT, WHOLE
from skincal.dataset.findings import did_you_mean
from skincal.dataset.table_file import RawTable
from skincal.model.arrays import BoolArray, FloatArray, IntArray

TAXEL = re.compile(r"taxel_(\d+)_(\d+)")
JOINT = re.compile(r"(q|tau)_(\d+)")

OPTIONAL = {name: column.cells for name, column in COLUMNS.items()}
"""Optional columns of presses and frames, with the kind of their cells."""

GIVE_OR_DROP = "Give the number, or leave the row out."
NO_FORCE = (
    "Without the force of each press, images determine the sensor's pose, but only the product of E and S, so that a "
    "calibration is impossible. Measure it (a gauge, a load cell, a scale below the sensor), or press with known "
    "weights and give their forces. A depth cannot replace it: E, which relates depth to force, is unknown."
)
CORRECT_OR_EMPTY = "Correct it, or leave the cell empty: not measured."

MOST_HINTS = 100
"""Largest number of unknown columns for which a known name is suggested."""


def is_number(values: FloatArray) -> BoolArray:
    """Return which values can be measurements: finite and below a generous bound."""
    return np.abs(values) < LARGEST


def repeated(rows: NDArray[Any]) -> BoolArray:
    """Return which rows (n,) or (n, m) of numbers repeat an earlier row; NaN equals NaN."""
    repeats = np.ones(len(rows), dtype=np.bool_)
    if not rows.size:
        return ~repeats
    plain = np.ascontiguousarray(rows.reshape(len(rows), -1))
    if plain.dtype.kind == "f":  # one bit pattern each for zero and NaN
        plain = np.where(np.isnan(plain), np.nan, plain + 0.0)
    whole = plain.view(np.dtype((np.void, plain.itemsize * plain.shape[1]))).reshape(-1)
    repeats[np.unique(whole, return_index=True)[1]] = False
    return repeats


_HOLDS: dict[str, Callable[[FloatArray], BoolArray]] = {
    ANY: is_number,
    NOT_NEGATIVE: lambda x: is_number(x) & (x >= 0),
    POSITIVE: lambda x: is_number(x) & (x > 0),
    WHOLE: lambda x: is_number(x) & (x >= 0) & (x == np.rint(x)),
}


class ColumnReader:
    """Reader of a table's columns that adds their problems to the findings.

    Missing or wrong values read as NaN, so that the rest can be checked as well.
    """

    def __init__(self, table: RawTable) -> None:
        self._table = table
        self.sheet = table.sheet
        self.rows = table.rows
        self._reported: dict[str, BoolArray] = {}

    def has(self, name: str) -> bool:
        """Return whether the table has the column."""
        return name in self._table.columns

    def require(self, names: Sequence[str]) -> None:
        """Add one error for all required columns that are missing."""
        missing = [name for name in names if not self.has(name)]
        if not missing:
            return
        spare = [name for name in self._table.columns if name not in names and name not in OPTIONAL]
        close = {name: did_you_mean(name, spare) for name in missing}
        hints = [f'Does "{other}" stand for {name}?' for name, other in close.items() if other]
        what = "column" if len(missing) == 1 else f"{len(missing)} columns"
        names = [*self._table.columns]
        semicolons = len(names) == 1 and ";" in names[0]
        separator = "The cells are separated by semicolons; separate them by commas." if semicolons else ""
        fix = " ".join(hints[:3]) or separator or _how_to_add(missing)
        expected, got = f"the {what} {_first(missing)}", f"the columns {_first(names, 12)}"
        self.sheet.findings.error(self.sheet.file, expected, got, fix)

    def numbers(self, name: str) -> FloatArray:
        """Return a column as numbers, shape (rows,), with NaN for empty cells; report cells that are not numbers."""
        return self._numbers(name)[0]

    def checked(
        self, name: str, kind: str, *, may_be_nan: BoolArray | bool = True, if_empty: str = ""
    ) -> FloatArray:
        """Return a column as numbers of a kind of :data:`OPTIONAL`, shape (rows,); report invalid cells.

        NaN (not measured) is permitted where ``may_be_nan`` is true, shape (rows,), or everywhere or nowhere;
        ``if_empty`` is the advice if the whole column is empty.
        """
        values, text = self._numbers(name)
        if self.has(name):
            bad = ~_HOLDS[kind](values) & ~(np.isnan(values) & may_be_nan) & ~text
            fix = CORRECT_OR_EMPTY if may_be_nan is True else GIVE_OR_DROP
            fix = if_empty if if_empty and np.isnan(values).all() and not text.any() else fix
            self.sheet.bad_rows(name, bad, values, kind, fix)
            values = np.where(bad, np.nan, values) if bad.any() else values
        return values

    def whole(self, name: str, expected: str, low: int, fix: str = "") -> IntArray:
        """Return a column of whole numbers of at least ``low``, shape (rows,), with ``low`` - 1 for invalid cells."""
        values, text = self._numbers(name)
        if not self.has(name):
            return np.zeros(self.rows, dtype=np.int64)
        good = is_number(values) & (values >= low) & (values == np.rint(values))
        self.sheet.bad_rows(name, ~good & ~text, values, expected, fix)
        return np.where(good, values, low - 1).astype(np.int64)

    def text(self, name: str) -> NDArray[Any]:
        """Return a column as text, shape (rows,), with '' for empty cells and NaN."""
        return _converted(self._table.columns[name], _word)

    def matrix(self, names: Sequence[str]) -> FloatArray:
        """Return several columns side by side, shape (rows, columns); missing ones are NaN."""
        matrix = np.empty((self.rows, len(names)))
        for j, name in enumerate(names):
            matrix[:, j] = self.numbers(name)
        return matrix

    def checked_matrix(
        self, names: Sequence[str], kind: str, *, may_be_nan: BoolArray | bool = True
    ) -> FloatArray:
        """Return several columns side by side, each :meth:`checked`, shape (rows, columns)."""
        return np.column_stack([self.checked(name, kind, may_be_nan=may_be_nan) for name in names])

    def is_reported(self, name: str) -> BoolArray:
        """Return which cells of a column were already reported as not numeric, shape (rows,)."""
        return self._reported.get(name, np.zeros(self.rows, dtype=bool))

    def taxel_columns(self, expected: Sequence[str]) -> Sequence[str]:
        """Return the ``expected`` taxel columns; if the sensor's size is unknown, those that the table has."""
        return expected or [name for name in self._table.columns if TAXEL.fullmatch(name)]

    def optional(
        self, known: Mapping[str, str], taken: Collection[str]
    ) -> Iterator[tuple[str, NDArray[Any]]]:
        """Yield names and values of all columns that are not ``taken``, in the order of the file.

        Known columns are checked, unknown ones are returned as they are. Unknown columns of lists or bytes are left out
        without being read.
        """
        names = [name for name in self._table.columns if name not in taken]
        unknown = [name for name in names if self._kind(name, known) is None]
        for name in unknown[:MOST_HINTS]:
            self._hint_unknown(name, known)
        for name in names:
            if name in self._table.others and self._kind(name, known) is None:
                place, got = self.sheet.column(name), self._table.others[name]
                self.sheet.findings.note(place, "single numbers or texts", got, "It is left out.")
            else:
                yield name, self.optional_column(name, known)

    def optional_column(self, name: str, known: Mapping[str, str]) -> NDArray[Any]:
        """Return one column, checked if it is known."""
        kind = self._kind(name, known)
        if kind is None:
            return self._table.columns[name]
        return self.text(name) if kind == TEXT else self.checked(name, kind)

    @staticmethod
    def _kind(name: str, known: Mapping[str, str]) -> str | None:
        return ANY if JOINT.fullmatch(name) else known.get(name)

    def _hint_unknown(self, name: str, known: Iterable[str]) -> None:
        findings, place = self.sheet.findings, self.sheet.column(name)
        match = TAXEL.fullmatch(name)
        if match:
            fix = "Correct rows and cols in dataset.toml, or take the column out."
            got = f"row {match[1]}, column {match[2]}"
            findings.error(place, "a taxel within [sensor] rows and cols", got, fix)
        elif close := did_you_mean(name, [k for k in known if not self.has(k)]):
            fix = f'It is kept but not used. Did you mean "{close}"?'
            findings.warn(place, "a known column", "an unknown one", fix)

    def _numbers(self, name: str) -> tuple[FloatArray, BoolArray]:
        """Return a column as numbers, and which cells are not numeric (reported here)."""
        column = self._table.columns.get(name)
        text = np.zeros(self.rows, dtype=bool)
        if column is None:
            return np.full(self.rows, np.nan), text
        if column.dtype != object and column.dtype != np.bool_:
            return column.astype(np.float64, copy=False), text
        numbers = _converted(column, _number)
        self._reported[name] = text = np.array([number is None for number in numbers], dtype=bool)
        decimal_comma = text.any() and "," in str(column[np.flatnonzero(text)[0]])
        fix = "Write a decimal point." if decimal_comma else "Write the number alone, in the column's unit."
        self.sheet.bad_rows(name, text, column, "a number", fix)
        return numbers.astype(np.float64), text


def _converted(column: NDArray[Any], convert: Callable[[Any], Any]) -> NDArray[Any]:
    """Return a column with every cell converted; each distinct cell is converted once, since columns have few."""
    cells: list[Any] = column.tolist()
    converted = {cell: convert(cell) for cell in dict.fromkeys(cells)}
    out = np.empty(len(cells), dtype=object)
    out[:] = [converted[cell] for cell in cells]
    return out


def _word(cell: object) -> str:
    """Return a cell as text, '' if it is empty, without the ``.0`` that whole numbers get in a column with gaps."""
    if cell != cell or cell in ("NaN", "nan"):
        return ""
    whole, point, rest = str(cell).partition(".")
    return whole if point and rest.strip("0") == "" and whole.lstrip("-").isdigit() else str(cell)


def _number(cell: object) -> float | None:
    """Return a cell as a number, NaN if it is empty; None if it is not numeric."""
    if cell is None or cell == "":
        return np.nan
    try:
        return float(cell) if isinstance(cell, str) else None
    except ValueError:
        return None


def _how_to_add(missing: Sequence[str]) -> str:
    if all(TAXEL.fullmatch(name) for name in missing):
        return "Add them, NaN throughout for a dead taxel, or correct [sensor] rows and cols in dataset.toml."
    if "force_n" in missing:
        return f"`skincal import` makes a dataset of a table with other names and units. {NO_FORCE}"
    return "Add what is missing; `skincal import` makes a dataset of a table with other names and units."


def _first(names: Sequence[str], shown: int = 6) -> str:
    return ", ".join(names[:shown]) + (f", … ({len(names)} in all)" if len(names) > shown else "")
