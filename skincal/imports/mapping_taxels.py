"""``[taxels]`` of a mapping file: from the source's image, in its order, to the dataset's."""

from __future__ import annotations

import string
from collections import Counter
from typing import cast

import numpy as np

from skincal.dataset import SensorSpec
from skincal.dataset.schema_errors import ABSENT, Translator
from skincal.imports.mapping import Taxels
from skincal.imports.mapping_file import PATTERN, VECTORS, BagTaxels, CsvTaxels, TaxelTable
from skincal.imports.recording import IntArray

Image = IntArray


def read_taxels(
    table: CsvTaxels | BagTaxels, sensor: SensorSpec, file: str, report: Translator, *, moments: bool
) -> Taxels:
    """Return ``[taxels]``, with placeholders for wrong values.

    The image of the source is first transposed (``transpose``), then its rows and columns are reversed
    (``flip_rows``, ``flip_cols``). The result is the dataset's image, ``rows`` x ``cols``. With ``moments``, rows of
    the source follow one another in time.
    """
    shape = (sensor.cols, sensor.rows) if table.transpose else (sensor.rows, sensor.cols)
    # Entry (r, c) of the source's image is its flat index in the source.
    image = _ordered(table, shape, report)
    names, axes = (), 1
    if isinstance(table, BagTaxels):
        items, count = table.elements, image.size
        if items is not None and (len({*items}) != count or len(items) != count or min(items) < 0):
            report.violation(("taxels", "elements"), f"{count} different indices of the array", items)
        elif items is not None:
            image = np.asarray(items, dtype=np.int64)[image]
    elif table.vectors is not None:
        names, axes = _vectors(table, image, report)
    else:
        names, image = _names(table, image, report)
    ours = image.T if table.transpose else image
    ours = ours[::-1] if table.flip_rows else ours
    ours = ours[:, ::-1] if table.flip_cols else ours
    return Taxels(f"{file}, [taxels]", table, names, tuple(ours.ravel().tolist()), axes, moments)


def _ordered(table: TaxelTable, shape: tuple[int, int], report: Translator) -> Image:
    """Return the source's image by its ``order``: row by row, column by column, or the index of every taxel."""
    flat = np.arange(shape[0] * shape[1])
    if table.order == "columns":
        return flat.reshape(shape[::-1]).T
    if table.order == "rows":
        return flat.reshape(shape)
    if sorted(table.order) != flat.tolist():
        expected = f'"rows", "columns", or the indices 0 to {len(flat) - 1} of all taxels, each once'
        report.violation(("taxels", "order"), expected, table.order)
        return flat.reshape(shape)
    return np.asarray(table.order, dtype=np.int64).reshape(shape)


def _names(table: CsvTaxels, image: Image, report: Translator) -> tuple[tuple[str, ...], Image]:
    """Return the names of the source's columns, and the index in them of each entry of its image."""
    given, count, place = table.columns, image.size, ("taxels", "columns")
    nothing = ("",) * count, image
    if isinstance(given, str):
        return _from_pattern(table, given, image, report)
    if not given:
        report.violation(place, PATTERN, ABSENT if given is None else given)
        return nothing
    if not isinstance(given[0], str):
        rows = cast("tuple[tuple[str, ...], ...]", given)
        if len(rows) != image.shape[0] or any(len(row) != image.shape[1] for row in rows):
            got = f"{len(rows)} rows of {', '.join(sorted({str(len(row)) for row in rows}))}"
            report.violation(place, f"{image.shape[0]} rows of {image.shape[1]} columns", got)
            return nothing
        given, image = tuple(name for row in rows for name in row), np.arange(count).reshape(image.shape)
    names = cast("tuple[str, ...]", given)
    if len(names) != count or not all(names):
        report.violation(place, f"the names of {count} columns (rows x cols)", f"{len(names)} entries")
        return nothing
    if doubled := sorted(name for name, times in Counter(names).items() if times > 1):
        report.violation(place, "each column once", ", ".join(doubled[:6]))
    return names, image


def _vectors(table: CsvTaxels, image: Image, report: Translator) -> tuple[tuple[str, ...], int]:
    """Return the columns of all taxels in the source's flat order, axis by axis, and the number of axes."""
    given, count, place = table.vectors, image.size, ("taxels", "vectors")
    nothing = ("",) * count, 1
    if table.columns is not None:
        report.violation(place, "columns or vectors", "both", "Remove one of them.")
    if isinstance(given, str):
        if "{axis}" not in given:
            report.violation(place, VECTORS, f'"{given}"', "Use {axis}.")
            return nothing
        if not table.axes:
            report.violation(("taxels", "axes"), 'names of the axes, like ["X", "Y", "Z"]', ABSENT)
            return nothing
        named = [_from_pattern(table, given.replace("{axis}", axis), image, report)[0] for axis in table.axes]
        return tuple(name for taxel in zip(*named, strict=True) for name in taxel), len(table.axes)
    rows = given or ()
    width = len(rows[0]) if rows else 0
    if len(rows) != count or not width or not all(len(row) == width and all(row) for row in rows):
        report.violation(place, VECTORS, f"{len(rows)} lists for {count} taxels")
        return nothing
    return tuple(name for row in rows for name in row), width


def _letters(number: int) -> str:
    """Return A, B, ..., Z, AA, AB, ... as spreadsheets count."""
    head, tail = divmod(number, 26)
    return (_letters(head - 1) if head else "") + chr(ord("A") + tail)


def _from_pattern(
    table: CsvTaxels, pattern: str, image: Image, report: Translator
) -> tuple[tuple[str, ...], Image]:
    try:
        fields = {field for _, field, _, _ in string.Formatter().parse(pattern) if field is not None}
    except ValueError:
        fields = set[str]()
    if {field.lower() for field in fields} not in ({"r", "c"}, {"j"}) or len(fields) > 2 or "J" in fields:
        fix = "Use {r} and {c}, or {j}; {R} and {C} are letters, A for the first."
        report.violation(("taxels", "columns"), PATTERN, f'"{pattern}"', fix)
        return ("",) * image.size, image
    first = table.first
    if fields == {"j"}:
        return tuple(pattern.format(j=first + j) for j in range(image.size)), image
    every = np.ndindex(*image.shape)
    names = [pattern.format(r=first + r, c=first + c, R=_letters(r), C=_letters(c)) for r, c in every]
    return tuple(names), np.arange(image.size).reshape(image.shape)
