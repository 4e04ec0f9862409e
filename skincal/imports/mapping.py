"""A mapping as an import uses it: the source of each column, of the image, and of its clock."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from collections.abc import Mapping as Map
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from skincal.dataset import DatasetMeta, TaxelPositions
from skincal.dataset.word_checks import as_word, swapped
from skincal.errors import input_error
from skincal.files import check_input, reason
from skincal.imports import targets
from skincal.imports.mapping_file import (
    BagMapping,
    BagTable,
    BagTaxels,
    CsvMapping,
    CsvSource,
    CsvTaxels,
    CutRules,
    JoinedFormat,
    Resampling,
    Rows,
)
from skincal.imports.recording import Column, FloatArray

_AROUND = 4
"""The direction of a field is that of so many rows before and after."""


@dataclass(frozen=True)
class Quantity:
    """Source of one column of the dataset.

    A number is ``scale * x + offset`` in ``unit``, then converted to SI.

    Attributes:
        target: column of the dataset.
        place: place of this entry in the mapping, for errors.
        sources: names of source columns, or field paths in a message; several: the length of that vector.
        topic: the topic of a bag, or the table of ``[files]``; '' for the file of the taxels and for a constant.
        constant: constant value instead of a source, in SI if it is a number; None if it is measured.
        scale: factor, with its sign.
        offset: added after the factor.
        words: meaning of words of the source; others are kept.
        wraps_at: period of the counter behind a time, in the source's numbers; None: found from the steps back.
        format: format of dates for ``strptime``; '' for ISO 8601.
        parts: of a time in several columns, which are added up (seconds and nanoseconds, a date and a time of day),
            the factor of each; empty: one column.
    """

    target: str
    place: str
    sources: tuple[str, ...] = ()
    topic: str = ""
    constant: float | str | None = None
    unit: targets.Unit = field(default_factory=lambda: targets.Unit("1"))
    scale: float = 1.0
    offset: float = 0.0
    words: Map[str, str] = field(default_factory=dict[str, str])
    wraps_at: float | None = None
    format: str = ""
    parts: tuple[float, ...] = ()

    def si(self, values: FloatArray) -> FloatArray:
        """Return numbers of the source in SI, of the same shape."""
        # A factor of one and a zero offset leave every bit unchanged.
        return (self.scale * values + self.offset) * self.unit.factor + self.unit.offset

    @property
    def is_text(self) -> bool:
        """True if the source holds words or dates."""
        return targets.is_text(self.target) or self.unit.name == targets.DATETIME

    def resampling(self, usual: Resampling) -> Resampling:
        """Return the method of resampling: a value between press 3 and press 4 belongs to neither."""
        return "previous" if targets.is_whole(self.target) else usual

    def column(
        self, rows: int, words: Callable[[str], Column], numbers: Callable[[str], FloatArray]
    ) -> Column:
        """Return the column of the dataset, shape (rows,), from what reads words and numbers of a source column."""
        if self.constant is not None:
            return np.full(
                rows, self.constant, dtype=object if isinstance(self.constant, str) else np.float64
            )
        if targets.is_text(self.target):
            return np.array([self.words.get(word, word) for word in words(self.sources[0])], dtype=object)
        parts = [self.si(numbers(name)) for name in self.sources]
        return parts[0] if len(parts) == 1 else np.linalg.norm(np.column_stack(parts), axis=1)


def source_columns(quantities: Iterable[Quantity]) -> tuple[list[str], list[str]]:
    """Return the source columns of quantities, each once: those of numbers, and those of words."""
    found: dict[bool, dict[str, None]] = {False: {}, True: {}}
    for quantity in quantities:
        found[quantity.is_text] |= dict.fromkeys(quantity.sources)
    return [*found[False]], [*found[True]]


def along_neighbours(change: FloatArray) -> FloatArray:
    """Return how far a change of vectors (n, J, axes) goes the way of the rows around it (n, J).

    The length of noise is never negative: at rest it reads more than half of the noise of all axes, and weak images
    come out too strong. Along a direction that the row itself has no part in, noise is as often negative.
    """
    known = np.nan_to_num(change)
    sums = np.concatenate([np.zeros_like(known[:1]), np.cumsum(known, axis=0)])
    row = np.arange(len(known))
    last, first = np.minimum(row + _AROUND + 1, len(known)), np.maximum(row - _AROUND, 0)
    around = sums[last] - sums[first] - known
    length: FloatArray = np.linalg.norm(around, axis=2)
    along: FloatArray = (change * around).sum(axis=2) / np.where(length > 0, length, 1.0)
    along[length == 0] = np.linalg.norm(change, axis=2)[length == 0]
    return along


@dataclass(frozen=True)
class Taxels:
    """Source of the image.

    ``names`` are the columns of the source in its own flat order, empty for a bag; ``order`` (J,) is, for each of our
    taxels, its index in the source. The value of a taxel with several ``axes``, side by side in ``names``, is the
    length of their change from rest. ``moments``: whether rows follow one another in time. ``wiring`` (J,) is the order
    by ``order``, ``transpose`` and flips alone.
    """

    place: str
    table: CsvTaxels | BagTaxels
    names: tuple[str, ...]
    order: tuple[int, ...]
    axes: int = 1
    moments: bool = False
    wiring: tuple[int, ...] = ()

    @property
    def is_rewired(self) -> bool:
        """Return whether the mapping gives the taxels another order than that of the source."""
        return self.wiring != tuple(range(len(self.wiring)))

    def counts(self, values: FloatArray) -> FloatArray:
        """Return images of the source, (rows, source columns), as counts that grow with load, (rows, J)."""
        table = self.table
        if table.swap_bytes or table.swap_words:
            values = swapped(values, swap_bytes=table.swap_bytes, swap_words=table.swap_words)
        if table.word:
            values = as_word(values, table.word)
        if isinstance(table, CsvTaxels) and self.axes > 1:
            vectors = values.reshape(len(values), -1, self.axes)
            change = vectors - np.nanmedian(vectors[: table.rest_rows], axis=0)
            values = along_neighbours(change) if self.moments else np.linalg.norm(change, axis=2)
        counts = table.scale * values[:, list(self.order)] + table.offset
        return counts if table.falling_from is None else table.falling_from - counts


@dataclass(frozen=True)
class JoinedFile:
    """A further file with its own clock: a force gauge, a position log; ``name`` is that of its table in ``[files]``.

    ``time`` are its stamps, None with a fixed rate.
    """

    name: str
    place: str
    form: JoinedFormat
    time: Quantity | None


@dataclass(frozen=True)
class Mapping:
    """The content of a mapping file; paths in it are relative to its folder.

    ``meta`` is that of ``dataset.toml``; there is one quantity per column of the dataset.
    """

    path: Path
    file: CsvMapping | BagMapping
    meta: DatasetMeta
    quantities: tuple[Quantity, ...]
    taxels: Taxels
    cut: CutRules
    joined: tuple[JoinedFile, ...] = ()
    positions: TaxelPositions | None = None
    meshes: Map[str, bytes] = field(default_factory=dict[str, bytes])

    @property
    def source(self) -> CsvSource | BagTable:
        """Options of the recording."""
        return self.file.csv if isinstance(self.file, CsvMapping) else self.file.bag

    @property
    def rows(self) -> Rows:
        """Meaning of a row of the source."""
        return self.file.csv.rows if isinstance(self.file, CsvMapping) else "series"

    @property
    def required(self) -> tuple[str, ...]:
        """Columns that have to be filled."""
        return targets.required_targets(self.rows, positions=bool(np.isfinite(self.meta.position.sigma_m)))

    @property
    def centres_m(self) -> FloatArray:
        """Centres of the taxels in the patch [m], shape (J, 2)."""
        if self.positions is not None:
            return self.positions.centres_m
        sensor = self.meta.sensor
        across, along = np.meshgrid(np.arange(float(sensor.cols)), np.arange(float(sensor.rows)))
        return np.column_stack([across.ravel(), along.ravel()]) * np.array(sensor.pitch_m)

    def resolve_file(self, name: str, what: str) -> Path:
        """Return the path of a file, or of a bag's folder, that the mapping names.

        Raises:
            InputError: it lies outside the mapping's folder, or is neither a file nor a folder.
        """
        path = self.path.parent / name
        try:
            check_input(path, within=self.path.parent)
        except (FileNotFoundError, IsADirectoryError):
            pass
        except OSError as error:
            fix = "Name it on the command line." if what.endswith("to read") else "Copy it there."
            raise input_error(f'{self.path.name}, "{name}"', what, reason(error), fix) from error
        return path

    def quantity(self, target: str) -> Quantity | None:
        """Return the source of a column; None if it is not mapped."""
        return next((q for q in self.quantities if q.target == target), None)

    def measures(self, target: str) -> bool:
        """Return True if a column comes from the recording, not from a constant of the mapping."""
        quantity = self.quantity(target)
        return quantity is not None and quantity.constant is None
