"""``[columns]`` of a mapping file: the source of each column of the dataset."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from skincal.dataset.columns import JOINT
from skincal.dataset.findings import Findings, did_you_mean
from skincal.imports import targets, units
from skincal.imports.mapping import Quantity
from skincal.imports.strict import StrictTable, as_list, as_table
from skincal.imports.units import Unit

SHARED = ("value", "unit", "sign", "scale", "offset", "words")
TIME_KEYS = ("wraps_at", "format")
SOURCES = {"csv": ("file", "column", "columns"), "bag": ("topic", "field", "fields")}
AXES = ("x", "y", "z")


def read_columns(table: StrictTable, source: str, rows: str, findings: Findings) -> tuple[Quantity, ...]:
    """Return the quantities of ``[columns]``.

    Args:
        table: the table.
        source: ``csv`` or ``bag``.
        rows: meaning of a row of the source.
        findings: collects the errors.
    """
    quantities: list[Quantity] = []
    for target, content in table.items().items():
        _check_target(table, target, rows)
        if isinstance(content, str) and source == "csv":
            content = {"column": content, "unit": _si_name(target)}
        entry = StrictTable(
            findings, table.file, f"columns.{target}", _as_table(table, target, content),
            (*SOURCES[source], *SHARED, *(TIME_KEYS if target == "time_s" else ())),
        )  # fmt: skip
        quantities += read_quantities(entry, target, source)
    doubled = {q.target for q in quantities if sum(p.target == q.target for p in quantities) > 1}
    for target in sorted(doubled):
        table.error(target, "each column once", "it occurs alone and in a vector")
    return tuple(quantities)


def _as_table(table: StrictTable, target: str, content: Any) -> dict[str, Any]:
    if as_table(content):
        return as_table(content)
    table.error(
        target, 'a table like { column = "Fz", unit = "mN" }, or for SI the name of a column', content
    )
    return {"value": 0.0, "unit": _si_name(target)}


def _check_target(table: StrictTable, target: str, rows: str) -> None:
    known = (*targets.known_targets(rows), *targets.VECTORS)
    if target in known or JOINT.fullmatch(target):
        return
    elsewhere = targets.known_targets(targets.SERIES if rows == targets.PRESSES else targets.PRESSES)
    close = did_you_mean(target, known)
    if target in elsewhere:
        table.error(target, f"a column of {rows}", f"one that only the other kind of rows has: {target}")
    elif close:
        table.error(target, "a known column", "an unknown one", f'Did you mean "{close}"?')
    elif target.startswith("taxel"):
        table.error(
            target, "taxels in the table [taxels]", "a single one", "Write a pattern or a list there."
        )


def read_quantities(entry: StrictTable, target: str, source: str) -> list[Quantity]:
    """Return the quantities of one entry: one, or the three of a vector."""
    parts = targets.VECTORS.get(target, (target,))
    found = _units(entry, parts[0])
    unit = found[0]
    constants = _constants(entry, target, parts, unit)
    names = [()] * len(parts) if constants is not None else _sources(entry, source, parts)
    sign = entry.number("sign", "1 or -1", default=1)
    if sign not in (1, -1) and not math.isnan(sign):
        entry.error("sign", "1 or -1", sign)
    scale = entry.number("scale", default=1.0)
    offset = entry.number("offset", default=0.0)
    return [
        Quantity(
            target=part,
            place=entry.label,
            sources=names[i],
            topic=_topic(entry, source) if constants is None else "",
            constant=None if constants is None else constants[i],
            unit=unit,
            scale=sign * scale,
            offset=sign * offset,
            words=_words(entry),
            wraps_at=entry.number("wraps_at", "what the counter counts to", default=None),
            parts=_parts(entry, found, len(names[i])) if target == "time_s" else (),
            format=entry.text("format", 'how dates are written, like "%d.%m.%Y %H:%M:%S.%f"', default=""),
        )
        for i, part in enumerate(parts)
    ]


def _topic(entry: StrictTable, source: str) -> str:
    if source == "csv":
        return entry.text("file", "the name of a table in [files]", default="")
    return entry.text("topic", "the topic's name")


def _units(entry: StrictTable, target: str) -> tuple[Unit, ...]:
    """Return the unit of a quantity; of a time in several columns, that of each."""
    kind = targets.quantity_of(target)
    known = ", ".join(units.FACTORS[kind])
    names = as_list(entry.raw("unit"))
    if target == "time_s" and names and all(isinstance(name, str) for name in names):
        return tuple(_unit(entry, kind, name) for name in names)
    if not entry.has("unit") and not targets.needs_unit(target):
        return (units.si_unit(kind),)
    return (_unit(entry, kind, entry.text("unit", f"a unit of {kind}: {known}")),)


def _unit(entry: StrictTable, kind: str, name: str) -> Unit:
    known = tuple(units.FACTORS[kind])
    unit = units.unit_of(kind, name)
    if unit is None and name:
        other = units.other_kind(name)
        close = did_you_mean(name, known)
        fix = f"{name} is a unit of {other}." if other else f'Did you mean "{close}"?' if close else ""
        entry.error("unit", f"a unit of {kind}: {', '.join(known)}", f'"{name}"', fix)
    return unit or units.si_unit(kind)


def _parts(entry: StrictTable, found: tuple[Unit, ...], columns: int) -> tuple[float, ...]:
    """Return the factors, in the first unit, with which the columns of a time are added; none for a single one."""
    dates = [unit.name == units.DATETIME for unit in found]
    if columns < 2 and len(found) < 2:
        return ()
    if len(found) == 1 and dates[0]:
        return (1.0,) * columns
    if len(found) != columns or any(dates):
        expected = 'a unit for each column, like ["s", "ns"], or "datetime" for a date and a time of day'
        entry.error("unit", expected, entry.raw("unit"))
    return tuple(unit.factor / found[0].factor for unit in found)


def _constants(entry: StrictTable, target: str, parts: Sequence[str], unit: Unit) -> list[float | str] | None:
    """Return the constant values in SI; None if the column is measured."""
    if not entry.has("value"):
        return None
    for key in ("column", "columns", "topic", "field", "fields"):
        if entry.has(key):
            entry.error(key, "a source or a constant value", "both", "Remove one of them.")
    if targets.is_text(parts[0]):
        return [entry.text("value", "a text")]
    shape = (len(parts),) if target in targets.VECTORS else ()
    values = entry.numbers("value", "a number" if not shape else "three numbers", shape, (0.0,) * len(parts))
    if not shape:
        values = (values,) if isinstance(values, float) else values
    return [value * unit.factor + unit.offset for value in values]


def _sources(entry: StrictTable, source: str, parts: Sequence[str]) -> list[tuple[str, ...]]:
    """Return the source columns, or field paths, of each part."""
    one, many = SOURCES[source][-2:]
    vector = len(parts) > 1
    if entry.has(one) and entry.has(many):
        entry.error(many, f"{one} or {many}", "both", "Remove one of them.")
    if entry.has(many):
        names = entry.texts(many, "a list of names")
        if vector and len(names) != len(parts):
            entry.error(many, f"{len(parts)} names", f"{len(names)}")
            names = ("",) * len(parts)
        return [(name,) for name in names] if vector else [names]
    if vector and source == "csv":
        entry.error(many, "a list of three columns", "nothing", f'Add {many} = ["x", "y", "z"].')
        return [("",)] * len(parts)
    name = entry.text(one, "the name of a column" if source == "csv" else "the path of a field")
    return [(f"{name}.{axis}",) for axis in AXES] if vector else [(name,)]


def _words(entry: StrictTable) -> dict[str, str]:
    words = as_table(entry.raw("words"))
    if entry.has("words") and not (words and all(isinstance(word, str) for word in words.values())):
        entry.error("words", 'a table like { loading = "up" }', entry.raw("words"))
        return {}
    return words


def _si_name(target: str) -> str:
    return units.si_unit(targets.quantity_of(targets.VECTORS.get(target, (target,))[0])).name
