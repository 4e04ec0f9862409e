"""``[taxels]`` of a mapping file: from the source's image, in its order, to the dataset's."""

from __future__ import annotations

import math
import string
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from skincal.dataset import SensorSpec
from skincal.dataset.word_checks import WIDTHS
from skincal.imports.mapping import Taxels
from skincal.imports.strict import StrictTable, as_list

KNOWN = (
    "order",
    "transpose",
    "flip_rows",
    "flip_cols",
    "scale",
    "offset",
    "falling_from",
    "word",
    "swap_bytes",
)
CSV_KEYS = ("columns", "first", "vectors", "axes", "rest_rows", *KNOWN)
BAG_KEYS = ("topic", "field", "elements", *KNOWN)

PATTERN = (
    'a pattern like "tax_{r}_{c}", "p{R}{c}" or "s{j}", a list of all columns, or a list of rows of them'
)
VECTORS = 'a pattern like "S-{axis}[{j}]" with axes, or a list of a list of columns for each taxel'
WORDS = tuple(f"{sign}int{bits}" for bits in WIDTHS for sign in ("u", ""))
REST_ROWS = 50
"""Default number of rows at rest at the start of a file."""


def read_taxels(table: StrictTable, sensor: SensorSpec, source: str) -> Taxels:
    """Return ``[taxels]``, with placeholders for wrong values.

    The image of the source is first transposed (``transpose``), then its rows and columns are reversed
    (``flip_rows``, ``flip_cols``). The result is the dataset's image, ``rows`` x ``cols``.
    """
    turned = table.flag("transpose", default=False)
    shape = (sensor.cols, sensor.rows) if turned else (sensor.rows, sensor.cols)
    # Entry (r, c) of the source's image is its flat index in the source.
    image = _ordered(table, shape)
    names: tuple[str, ...] = ()
    axes = 1
    if source == "csv" and table.has("vectors"):
        names, axes = _vectors(table, image)
    elif source == "csv":
        names, image = _names(table, image)
    elif table.has("elements"):
        image = _elements(table, image)
    ours = image.T if turned else image
    ours = ours[::-1] if table.flag("flip_rows", default=False) else ours
    ours = ours[:, ::-1] if table.flag("flip_cols", default=False) else ours
    falling = table.number("falling_from", "the reading without load", default=None)
    return Taxels(
        place=table.label,
        names=names,
        topic=table.text("topic", "the topic's name") if source == "bag" else "",
        field=table.text("field", "the path of the array, like data") if source == "bag" else "",
        order=tuple(ours.ravel().tolist()),
        scale=_finite(table, "scale", 1.0),
        offset=_finite(table, "offset", 0.0),
        falling_from=falling if falling is None or math.isfinite(falling) else 0.0,
        word=(table.choice("word", WORDS) or "") if table.has("word") else "",
        swap_bytes=table.flag("swap_bytes", default=False),
        axes=axes,
        rest_rows=table.whole("rest_rows", "a number of rows, at least 1", low=1)
        if table.has("rest_rows")
        else REST_ROWS,
    )


def _ordered(table: StrictTable, shape: tuple[int, int]) -> NDArray[np.int64]:
    """Return the source's image by its ``order``: row by row, column by column, or the index of every taxel."""
    flat = np.arange(shape[0] * shape[1])
    given = table.raw("order")
    if not isinstance(given, list):
        if table.choice("order", ("rows", "columns"), default="rows") == "columns":
            return flat.reshape(shape[::-1]).T
        return flat.reshape(shape)
    items = cast("list[Any]", given)
    whole = all(isinstance(item, int) and not isinstance(item, bool) for item in items)
    if not whole or sorted(items) != flat.tolist():
        expected = f'"rows", "columns", or the indices 0 to {len(flat) - 1} of all taxels, each once'
        table.error("order", expected, items)
        return flat.reshape(shape)
    return np.asarray(items, dtype=np.int64).reshape(shape)


def _finite(table: StrictTable, key: str, default: float) -> float:
    value = table.number(key, default=default)
    return default if math.isnan(value) else float(value)


def _names(table: StrictTable, image: NDArray[np.int64]) -> tuple[tuple[str, ...], NDArray[np.int64]]:
    """Return the names of the source's columns, and the index in them of each entry of its image."""
    given = table.raw("columns")
    count = image.size
    nothing = ("",) * count
    if isinstance(given, str):
        return _from_pattern(table, given, image)
    items = as_list(given)
    if not items:
        table.error("columns", PATTERN, "nothing" if given is None else given)
        return nothing, image
    if all(isinstance(row, list) for row in items):
        rows = cast("list[list[Any]]", items)
        if len(rows) != image.shape[0] or any(len(row) != image.shape[1] for row in rows):
            got = f"{len(rows)} rows of {', '.join(sorted({str(len(row)) for row in rows}))}"
            table.error("columns", f"{image.shape[0]} rows of {image.shape[1]} columns", got)
            return nothing, image
        items, image = [name for row in rows for name in row], np.arange(count).reshape(image.shape)
    if len(items) != count or not all(isinstance(name, str) and name for name in items):
        table.error("columns", f"the names of {count} columns (rows x cols)", f"{len(items)} entries")
        return nothing, image
    doubled = sorted({name for name in items if items.count(name) > 1})
    if doubled:
        table.error("columns", "each column once", ", ".join(doubled[:6]))
    return tuple(items), image


def _vectors(table: StrictTable, image: NDArray[np.int64]) -> tuple[tuple[str, ...], int]:
    """Return the columns of all taxels in the source's flat order, axis by axis, and the number of axes."""
    given, count = table.raw("vectors"), image.size
    if table.has("columns"):
        table.error("vectors", "columns or vectors", "both", "Remove one of them.")
    if isinstance(given, str):
        axes = table.texts("axes", 'names of the axes, like ["X", "Y", "Z"]')
        if "{axis}" not in given:
            table.error("vectors", VECTORS, f'"{given}"', "Use {axis}.")
            return ("",) * count, 1
        named = [_from_pattern(table, given.replace("{axis}", axis), image)[0] for axis in axes]
        return tuple(name for taxel in zip(*named, strict=True) for name in taxel), max(len(axes), 1)
    rows = [as_list(row) for row in as_list(given)]
    width = len(rows[0]) if rows else 0
    good = all(len(row) == width and all(isinstance(name, str) and name for name in row) for row in rows)
    if len(rows) != count or not width or not good:
        table.error("vectors", VECTORS, f"{len(rows)} lists for {count} taxels")
        return ("",) * count, 1
    return tuple(name for row in rows for name in row), width


def _letters(number: int) -> str:
    """Return A, B, ..., Z, AA, AB, ... as spreadsheets count."""
    head, tail = divmod(number, 26)
    return (_letters(head - 1) if head else "") + chr(ord("A") + tail)


def _from_pattern(
    table: StrictTable, pattern: str, image: NDArray[np.int64]
) -> tuple[tuple[str, ...], NDArray[np.int64]]:
    value = table.raw("first") if table.has("first") else 0
    first = value if isinstance(value, int) and not isinstance(value, bool) else 0
    if first != value:
        table.error("first", "the first number of rows, columns or taxels, like 0 or 1", value)
    try:
        fields = {field for _, field, _, _ in string.Formatter().parse(pattern) if field is not None}
    except ValueError:
        fields = set[str]()
    if {field.lower() for field in fields} not in ({"r", "c"}, {"j"}) or len(fields) > 2 or "J" in fields:
        fix = "Use {r} and {c}, or {j}; {R} and {C} are letters, A for the first."
        table.error("columns", PATTERN, f'"{pattern}"', fix)
        return ("",) * image.size, image
    if fields == {"j"}:
        return tuple(pattern.format(j=first + j) for j in range(image.size)), image
    rows, cols = image.shape
    names = [
        pattern.format(r=first + r, c=first + c, R=_letters(r), C=_letters(c))
        for r in range(rows)
        for c in range(cols)
    ]
    return tuple(names), np.arange(image.size).reshape(image.shape)


def _elements(table: StrictTable, image: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the image with the indices of a message's array that the mapping selects."""
    given = table.raw("elements")
    items = as_list(given)
    good = all(isinstance(item, int) and not isinstance(item, bool) and item >= 0 for item in items)
    if len(items) != image.size or not good or len(set(items)) != len(items):
        table.error("elements", f"{image.size} different indices of the array", given)
        return image
    return np.asarray(items, dtype=np.int64)[image]
