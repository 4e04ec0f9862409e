"""``[columns]`` and ``[taxels]`` of a mapping file: the sources of the dataset's columns and of its image."""

from __future__ import annotations

import string
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import cast

import numpy as np

from skincal.dataset import SensorSpec
from skincal.dataset.columns import JOINT
from skincal.dataset.findings import meant
from skincal.dataset.schema_errors import ABSENT, Place, Translator
from skincal.imports import targets
from skincal.imports.mapping import Quantity, Taxels
from skincal.imports.mapping_file import (
    AXES_PATTERN,
    PATTERN,
    BagEntry,
    BagTaxels,
    CsvEntry,
    CsvTaxels,
    TaxelTable,
)
from skincal.imports.recording import IntArray

AXES = ("x", "y", "z")
AnyEntry = CsvEntry | BagEntry


def read_columns(
    entries: Mapping[str, AnyEntry], rows: str, file: str, report: Translator
) -> tuple[Quantity, ...]:
    """Return the quantities of ``[columns]``."""
    found: list[Quantity] = []
    for target, entry in entries.items():
        _check_target(target, rows, report)
        found += read_quantities(entry, target, ("columns", target), file, report)
    names = [quantity.target for quantity in found]
    for target in sorted(name for name, times in Counter(names).items() if times > 1):
        report.violation(("columns", target), "each column once", "it occurs alone and in a vector")
    return tuple(found)


def si_name(target: str) -> str:
    """Return the SI unit of a column, or of the columns of a vector."""
    return targets.si_unit(targets.quantity_of(targets.VECTORS.get(target, (target,))[0])).name


def _check_target(target: str, rows: str, report: Translator) -> None:
    known = (*targets.known_targets(rows), *targets.VECTORS)
    if target in known or JOINT.fullmatch(target):
        return
    place = ("columns", target)
    elsewhere = targets.known_targets(targets.SERIES if rows == targets.PRESSES else targets.PRESSES)
    if target in elsewhere:
        report.violation(place, f"a column of {rows}", f"one that only the other kind of rows has: {target}")
    elif fix := meant(target, known):
        report.violation(place, "a known column", "an unknown one", fix)
    elif target.startswith("taxel"):
        fix = "Write a pattern or a list there."
        report.violation(place, "taxels in the table [taxels]", "a single one", fix)


def read_quantities(
    entry: AnyEntry, target: str, place: Place, file: str, report: Translator
) -> list[Quantity]:
    """Return the quantities of one entry at a place of the mapping: one, or the three of a vector."""
    parts = targets.VECTORS.get(target, (target,))
    found = _units(entry, parts[0], place, report)
    constants = _constants(entry, parts, found[0], place, report)
    names = [()] * len(parts) if constants is not None else _sources(entry, parts, place, report)
    if abs(entry.sign) not in (1.0, 0.0) or entry.sign == 0:
        report.violation((*place, "sign"), "1 or -1", entry.sign)
    for key in ("wraps_at", "format"):
        if target != "time_s" and (given := getattr(entry, key)):
            report.violation((*place, key), "no such key: it is for times", given, "Remove it.")
    if constants is None and isinstance(entry, BagEntry) and not entry.topic:
        report.violation((*place, "topic"), "the topic's name", ABSENT)
    return [
        Quantity(
            target=part,
            place=f"{file}, [{'.'.join(map(str, place))}]",
            sources=names[i],
            topic=entry.source[0] if constants is None else "",
            constant=None if constants is None else constants[i],
            unit=found[0],
            scale=entry.sign * entry.scale,
            offset=entry.sign * entry.offset,
            words=entry.words,
            wraps_at=entry.wraps_at,
            parts=_parts(entry, found, len(names[i]), place, report) if target == "time_s" else (),
            format=entry.format,
        )
        for i, part in enumerate(parts)
    ]


def _units(entry: AnyEntry, target: str, place: Place, report: Translator) -> tuple[targets.Unit, ...]:
    """Return the unit of a quantity; of a time in several columns, that of each."""
    kind, place = targets.quantity_of(target), (*place, "unit")
    known = tuple(targets.FACTORS[kind])
    expected = f"a unit of {kind}: {', '.join(known)}"
    names = (entry.unit,) if isinstance(entry.unit, str) else entry.unit
    if names is None:
        if targets.needs_unit(target):
            report.violation(place, expected, ABSENT)
        return (targets.si_unit(kind),)
    if len(names) != 1 and target != "time_s":
        report.violation(place, expected, names)
        return (targets.si_unit(kind),)
    found = [targets.unit_of(kind, name) for name in names]
    for name, unit in zip(names, found, strict=True):
        if unit is None:
            other = targets.other_kind(name)
            fix = f"{name} is a unit of {other}." if other else meant(name, known)
            report.violation(place, expected, f'"{name}"', fix)
    return tuple(unit or targets.si_unit(kind) for unit in found) or (targets.si_unit(kind),)


def _parts(
    entry: AnyEntry, found: tuple[targets.Unit, ...], columns: int, place: Place, report: Translator
) -> tuple[float, ...]:
    """Return the factors, in the first unit, with which the columns of a time are added; none for a single one."""
    dates = [unit.name == targets.DATETIME for unit in found]
    if columns < 2 and len(found) < 2:
        return ()
    if len(found) == 1 and dates[0]:
        return (1.0,) * columns
    if len(found) != columns or any(dates):
        expected = 'a unit for each column, like ["s", "ns"], or "datetime" for a date and a time of day'
        report.violation((*place, "unit"), expected, entry.unit)
    return tuple(unit.factor / found[0].factor for unit in found)


def _constants(
    entry: AnyEntry, parts: Sequence[str], unit: targets.Unit, place: Place, report: Translator
) -> list[float | str] | None:
    value = entry.value
    if value is None:
        return None
    if any(entry.source):
        report.violation((*place, "value"), "a source or a constant value", "both", "Remove one of them.")
    numbers = value if isinstance(value, tuple) else (value,)
    text = targets.is_text(parts[0])
    if len(numbers) != len(parts) or text != isinstance(value, str):
        expected = "a text" if text else "a number" if len(parts) == 1 else "three numbers"
        report.violation((*place, "value"), expected, value)
    return [one if isinstance(one, str) else one * unit.factor + unit.offset for one in numbers]


def _sources(
    entry: AnyEntry, parts: Sequence[str], place: Place, report: Translator
) -> list[tuple[str, ...]]:
    one, many = ("column", "columns") if isinstance(entry, CsvEntry) else ("field", "fields")
    _, name, names = entry.source
    vector = len(parts) > 1
    if name is not None and names:
        report.violation((*place, many), f"{one} or {many}", "both", "Remove one of them.")
    if names:
        if vector and len(names) != len(parts):
            report.violation((*place, many), f"{len(parts)} names", f"{len(names)}")
            names = ("",) * len(parts)
        return [(name,) for name in names] if vector else [names]
    if vector and one == "column":
        fix = f'Add {many} = ["x", "y", "z"].'
        report.violation((*place, many), "a list of three columns", ABSENT, fix)
        return [("",)] * len(parts)
    if name is None:
        expected = "the name of a column" if one == "column" else "the path of a field"
        report.violation((*place, one), expected, ABSENT)
    return [(f"{name}.{axis}",) for axis in AXES] if vector else [(name or "",)]


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
    names, axes, items = (), 1, None
    if isinstance(table, BagTaxels):
        items, count = table.elements, image.size
        if items is not None and (len({*items}) != count or len(items) != count or min(items) < 0):
            report.violation(("taxels", "elements"), f"{count} different indices of the array", items)
            items = None
    elif table.vectors is not None:
        names, axes = _vectors(table, image, report)
    else:
        names, image = _names(table, image, report)
    ours = image.T if table.transpose else image
    ours = ours[::-1] if table.flip_rows else ours
    ours = ours[:, ::-1] if table.flip_cols else ours
    wiring = tuple(ours.ravel().tolist())
    order = wiring if items is None else tuple(items[j] for j in wiring)
    return Taxels(f"{file}, [taxels]", table, names, order, axes, moments, wiring)


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
        given, image = tuple(name for row in rows for name in row), _placed(table, image)
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
            report.violation(place, AXES_PATTERN, f'"{given}"', "Use {axis}.")
            return nothing
        if not table.axes:
            report.violation(("taxels", "axes"), 'names of the axes, like ["X", "Y", "Z"]', ABSENT)
            return nothing
        named = [_from_pattern(table, given.replace("{axis}", axis), image, report)[0] for axis in table.axes]
        return tuple(name for taxel in zip(*named, strict=True) for name in taxel), len(table.axes)
    rows = given or ()
    width = len(rows[0]) if rows else 0
    if len(rows) != count or not width or not all(len(row) == width and all(row) for row in rows):
        report.violation(place, AXES_PATTERN, f"{len(rows)} lists for {count} taxels")
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
    return tuple(names), _placed(table, image)


def _placed(table: CsvTaxels, image: Image) -> Image:
    """Return the index of each entry of an image whose columns are named by row and column; a list reorders it."""
    return image if isinstance(table.order, tuple) else np.arange(image.size).reshape(image.shape)
