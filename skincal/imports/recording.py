"""A recording as read: named columns in SI and images, file by file, then as one time series before cutting."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from skincal.model.arrays import BoolArray, FloatArray, IntArray

if TYPE_CHECKING:
    from skincal.imports.alignment import JoinedClock

Column = NDArray[Any]


@dataclass(frozen=True, eq=False)
class Series:
    """Input of a cutter, each (M,): session clock [s], ascending, and normal force [N], finite.

    No press extends over two files, whose index is ``part``. Numbers of presses, -1 for none, and words of phases are
    None without such a column. ``sigma_n`` is the noise of the taxels where they stand for the force, else 0.
    """

    time_s: FloatArray
    force_n: FloatArray
    part: IntArray
    press: IntArray | None = None
    phase: Column | None = None
    sigma_n: float = 0.0

    def __len__(self) -> int:
        return len(self.time_s)

    def select(self, rows: NDArray[Any]) -> Series:
        """Return the series with only these rows."""
        press, phase = (None if column is None else column[rows] for column in (self.press, self.phase))
        return Series(self.time_s[rows], self.force_n[rows], self.part[rows], press, phase, self.sigma_n)


@dataclass(frozen=True)
class Span:
    """A press in a series, as indices; ``stop`` and ``hold_stop`` are one past the last.

    It starts with the contact, or with the ramp that leads to a plateau. ``rising`` says that the force rises before
    the hold, which is then loading; ``branch`` is ``up`` or ``down`` for a plateau, '' for a single press.
    """

    number: int
    start: int
    hold: int
    hold_stop: int
    stop: int
    rising: bool = True
    branch: str = ""


@dataclass(frozen=True)
class Rejected:
    """A span that is not a press, with the reason; its samples are left out."""

    start: int
    stop: int
    why: str


@dataclass(frozen=True)
class Cut:
    """Result of a cutter."""

    spans: tuple[Span, ...]
    rejected: tuple[Rejected, ...] = ()


def runs(mask: BoolArray, part: IntArray | None = None) -> list[tuple[int, int]]:
    """Return the stretches ``[start, stop)`` where a mask holds; a change of ``part`` ends a stretch."""
    edges = np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8))
    starts, stops = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    if part is not None:
        breaks = np.flatnonzero((np.diff(part) != 0) & mask[1:] & mask[:-1]) + 1
        starts, stops = np.sort(np.append(starts, breaks)), np.sort(np.append(stops, breaks))
    return list(zip(starts.tolist(), stops.tolist(), strict=True))


@dataclass(frozen=True)
class Dropped:
    """Samples that were left out of the dataset, with the reason."""

    count: int
    what: str
    why: str

    def __str__(self) -> str:
        plural = "" if self.count == 1 else "es" if self.what.endswith("s") else "s"
        return f"{self.count} {self.what}{plural}: {self.why}"


@dataclass(frozen=True)
class ReadFile:
    """A file that was read, with its number of rows, or of messages of the taxels' topic.

    ``lines`` are the line numbers of the rows, None for a file without lines.
    """

    file: str
    rows: int
    lines: IntArray | None = field(default=None, repr=False, compare=False)


@dataclass(frozen=True, eq=False)
class Recording:
    """A recording: columns of equal length.

    Attributes:
        columns: columns by name of the dataset's column, in SI; numbers with NaN, or text with ''.
        counts: images, shape (M, J).
        part: index of the file of each row, shape (M,).
        row: index of each row in its file, shape (M,).
        dropped: rows that a reader left out.
        notes: repairs by the reader that the user should know.
        clocks: alignment of the clocks of other files with that of the taxels.
    """

    columns: Mapping[str, Column]
    counts: FloatArray
    part: IntArray
    row: IntArray
    files: tuple[ReadFile, ...]
    dropped: tuple[Dropped, ...] = ()
    notes: tuple[str, ...] = ()
    clocks: tuple[JoinedClock, ...] = ()

    def __len__(self) -> int:
        return len(self.part)

    def select(self, rows: NDArray[Any], dropped: tuple[Dropped, ...] = ()) -> Recording:
        """Return the recording with only these rows, with a report on the others."""
        columns = {name: column[rows] for name, column in self.columns.items()}
        counts, part, row = self.counts[rows], self.part[rows], self.row[rows]
        dropped = (*self.dropped, *dropped)
        return replace(self, columns=columns, counts=counts, part=part, row=row, dropped=dropped)

    def without(self, what: str, bad: Mapping[str, BoolArray]) -> Recording:
        """Return the recording without the rows of some masks, by the reason; the first reason of a row counts."""
        kept = np.ones(len(self), dtype=bool)
        dropped: list[Dropped] = []
        for why, rows in bad.items():
            dropped.append(Dropped(int((rows & kept).sum()), what, why))
            kept &= ~rows
        return self if kept.all() else self.select(kept, summed(dropped))

    def vector(self, names: tuple[str, ...]) -> FloatArray:
        """Return three columns side by side, shape (M, 3); NaN if a column is not mapped."""
        nothing = np.full(len(self), np.nan)
        return np.column_stack([self.columns.get(name, nothing) for name in names])


def joined(parts: Sequence[Recording]) -> Recording:
    """Return recordings joined one after the other."""
    return Recording(
        {name: np.concatenate([part.columns[name] for part in parts]) for name in parts[0].columns},
        np.concatenate([part.counts for part in parts]),
        np.concatenate([part.part for part in parts]),
        np.concatenate([part.row for part in parts]),
        tuple(file for part in parts for file in part.files),
        summed([dropped for part in parts for dropped in part.dropped]),
    )


def summed(dropped: Iterable[Dropped]) -> tuple[Dropped, ...]:
    """Return the dropped samples, with equal reasons added up."""
    counts: Counter[tuple[str, str]] = Counter()
    for item in dropped:
        counts[item.what, item.why] += item.count
    return tuple(Dropped(count, what, why) for (what, why), count in counts.items() if count)
