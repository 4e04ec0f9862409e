"""Findings: collected problems of a dataset, so that all are reported at once.

An error makes the dataset unusable (exit status 2); a warning is something that the user should know.
"""

from __future__ import annotations

import difflib
import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skincal.errors import InputError, Problem, first_of
from skincal.model.arrays import BoolArray

SHOWN = 3
"""Number of rows of one kind that a message names; further rows are counted."""

MOST_PROBLEMS = 1000
"""Largest number of problems of one kind that are stored: a file may have a mistake in every line."""

LONGEST_NAME = 64
"""Length of the longest word that is compared with known names."""


class Findings:
    """Errors and warnings found so far, in the order of the files; places in a ``folder`` are shown with it."""

    def __init__(self, folder: Path | None = None) -> None:
        self._folder = folder
        self.errors: list[Problem] = []
        self.warnings: list[Problem] = []

    def error(
        self, place: str, expected: str, got: object, fix: str = "", code: str = "", **details: Any
    ) -> None:
        """Add an error."""
        self._add(self.errors, Problem(self._whole(place), expected, str(got), fix, code, details=details))

    def warn(
        self, place: str, expected: str, got: object, fix: str = "", code: str = "", **details: Any
    ) -> None:
        """Add a warning."""
        self._add(self.warnings, Problem(self._whole(place), expected, str(got), fix, code, details=details))

    def note(
        self, place: str, expected: str, got: object, fix: str = "", code: str = "", **details: Any
    ) -> None:
        """Add a note, the mildest kind of warning: the values may be intended."""
        self._add(self.warnings, Problem(self._whole(place), expected, str(got), fix, code, "note", details))

    def _add(self, problems: list[Problem], problem: Problem) -> None:
        if len(problems) < MOST_PROBLEMS:
            problems.append(problem)

    def _whole(self, place: str) -> str:
        folder = str(self._folder or "")
        if not folder or place == folder or place.startswith(folder + os.sep):
            return place
        return str(Path(folder) / place)

    def raise_errors(self) -> None:
        """Raise all errors as one :class:`InputError`, if there are any."""
        if self.errors:
            raise InputError(self.errors)


class Sheet:
    """Names of places in one table, for problems that are added to the findings.

    ``header_lines`` come before the first row of a text file; None for a binary file.
    """

    def __init__(self, findings: Findings, file: str, header_lines: int | None) -> None:
        self.findings = findings
        self.file = file
        self._header_lines = header_lines

    def column(self, *names: str) -> str:
        """Return the place of a column, or of several."""
        return f"{self.file}, column{'s' * (len(names) > 1)} {', '.join(names)}"

    def rows(self, name: str, rows: ArrayLike, total: int | None = None) -> str:
        """Return the place of some rows of a column, the first of ``total``; rows count from 0, messages from 1."""
        index = np.asarray(rows)
        count = index.size if total is None else total
        line = (
            "" if count > 1 or self._header_lines is None else f" (line {index[0] + 1 + self._header_lines})"
        )
        named = first_of(index[:SHOWN] + 1, SHOWN, count)
        return f"{self.column(name)}, {'row' if count == 1 else 'rows'} {named}{line}"

    def bad_rows(
        self,
        name: str,
        bad: ArrayLike,
        values: Sequence[Any] | NDArray[Any],
        expected: str,
        fix: str = "",
        *,
        warning: bool = False,
    ) -> None:
        """Add one problem for all rows of a column where ``bad`` holds, shape (rows,)."""
        index = np.flatnonzero(np.asarray(bad))
        if index.size:
            add = self.findings.warn if warning else self.findings.error
            add(self.rows(name, index), expected, listed([values[i] for i in index[:SHOWN]], index.size), fix)

    def bad_cells(
        self, cells: BadCells, expected: str, fix: str = "", code: str = "", **details: Any
    ) -> None:
        """Add one problem for all cells of some columns that have the same fault."""
        if not cells.counts:
            return
        total, first = sum(cells.counts.values()), sorted(cells.first)[:SHOWN]
        got = listed([value for *_, value in first], total)
        if len(cells.counts) == 1:
            ((name, _),) = cells.counts.items()
            rows = np.array([row for row, *_ in first])
            self.findings.error(self.rows(name, rows, total), expected, got, fix, code, **details)
            return
        named = first_of((f"{name} row {row + 1}" for row, _, name, _ in first), SHOWN, total)
        place = f"{self.file}, {len(cells.counts)} columns: {named}{' cells' if total > SHOWN else ''}"
        self.findings.error(place, expected, got, fix, code, **details)


class BadCells:
    """Cells with the same fault, collected column by column: their number, and the first of each column."""

    def __init__(self) -> None:
        self.counts: dict[str, int] = {}
        self.first: list[tuple[int, int, str, Any]] = []

    def add(self, name: str, bad: BoolArray, values: NDArray[Any]) -> None:
        """Add the rows of a column where ``bad`` holds, shape (rows,)."""
        if bad.any():
            index = np.flatnonzero(bad)
            self.first += [(int(row), len(self.counts), name, values[row]) for row in index[:SHOWN]]
            self.counts[name] = index.size


def listed(values: Iterable[Any], count: int) -> str:
    """Return the first values as text, with dots if there are more."""
    shown = [
        repr(v) if isinstance(v, str) else f"{v:.6g}" if isinstance(v, float) else str(v) for v in values
    ]
    return ", ".join(shown) + (", …" if count > len(shown) else "")


def did_you_mean(name: str, known: Iterable[str]) -> str | None:
    """Return the known name closest to a mistyped one; None if none is close."""
    if len(name) > LONGEST_NAME:
        return None
    # One wrong letter lowers the similarity of a short word more.
    spelling = {word.lower(): word for word in known}
    close = difflib.get_close_matches(name.lower(), spelling, n=1, cutoff=0.6 if len(name) < 6 else 0.75)
    return spelling[close[0]] if close else None


def meant(name: str, known: Iterable[str], otherwise: str = "") -> str:
    """Return the advice for a mistyped name: the closest known name, or ``otherwise`` if none is close."""
    close = did_you_mean(name, known)
    return f'Did you mean "{close}"?' if close else otherwise
