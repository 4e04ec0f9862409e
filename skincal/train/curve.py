"""The learning curve as a table on disk: one row a round."""

from __future__ import annotations

import csv
import io
import os
from dataclasses import astuple
from pathlib import Path
from typing import IO, Self

import numpy as np
from numpy.typing import NDArray

from skincal.bounded import UnreadableError, parse_csv, read_text
from skincal.errors import input_error
from skincal.files import reason, whole_file
from skincal.train.watch import COLUMNS, Round


class Curve:
    """Appends rows to a CSV file; each is on disk as soon as it is known.

    Args:
        steps: rows beyond so many environment steps are dropped: the run goes on from a checkpoint before them.
    """

    def __init__(self, path: Path, steps: int) -> None:
        rows = [row for row in _rows(path) if float(row[0]) <= steps]
        with whole_file(path, force=True) as temporary:
            temporary.write_text(_text([list(COLUMNS), *rows]), encoding="utf-8")
        self._file: IO[str] = path.open("a", encoding="utf-8", newline="")

    def __enter__(self) -> Self:
        """Ready to be written to."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the file."""
        self._file.close()

    def add(self, row: Round) -> None:
        """Append a row."""
        values = astuple(row)
        self._file.write(_text([[str(values[0]), *(f"{value:.6g}" for value in values[1:])]]))
        self._file.flush()

    def sync(self) -> None:
        """Bring the rows to the disk."""
        os.fsync(self._file.fileno())


def read_curve(path: str | Path) -> dict[str, NDArray[np.float64]]:
    """Return the columns of a learning curve by name (see :class:`~skincal.train.watch.Round`).

    Raises:
        InputError: there is no such file, or it is something else.
    """
    path = Path(path)
    rows = _rows(path)
    if not rows:
        raise input_error(str(path), "the learning curve of a training run", "nothing")
    columns = np.array(rows, dtype=np.float64).T
    return dict(zip(COLUMNS, columns, strict=True))


def _rows(path: Path) -> list[list[str]]:
    """Return whole rows below the head; the last line of a killed run may be cut off."""
    try:
        head, *rows = parse_csv(read_text(path, within=path.parent)) or [[]]
        if tuple(head) != COLUMNS:
            raise UnreadableError(f"the columns {', '.join(COLUMNS)}", ", ".join(head)[:200])
    except FileNotFoundError:
        return []
    except OSError as error:
        raise input_error(str(path), "a learning curve", reason(error)) from None
    except UnreadableError as error:
        raise input_error(str(path), error.expected, error.got) from None
    whole = [row for row in rows if len(row) == len(COLUMNS) and all(map(_is_number, row))]
    if len(whole) < len(rows) - 1:
        raise input_error(str(path), f"{len(COLUMNS)} numbers in every row", "other rows")
    return whole


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _text(rows: list[list[str]]) -> str:
    buffer = io.StringIO()
    csv.writer(buffer, lineterminator="\n").writerows(rows)
    return buffer.getvalue()
