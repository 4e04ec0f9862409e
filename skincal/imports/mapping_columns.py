"""``[columns]`` of a mapping file: the source of each column of the dataset."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

from skincal.dataset.columns import JOINT
from skincal.dataset.findings import meant
from skincal.dataset.schema_errors import ABSENT, Place, Translator
from skincal.imports import targets, units
from skincal.imports.mapping import Quantity
from skincal.imports.mapping_file import BagEntry, CsvEntry
from skincal.imports.units import Unit

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
    return units.si_unit(targets.quantity_of(targets.VECTORS.get(target, (target,))[0])).name


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


def _units(entry: AnyEntry, target: str, place: Place, report: Translator) -> tuple[Unit, ...]:
    """Return the unit of a quantity; of a time in several columns, that of each."""
    kind, place = targets.quantity_of(target), (*place, "unit")
    known = tuple(units.FACTORS[kind])
    expected = f"a unit of {kind}: {', '.join(known)}"
    names = (entry.unit,) if isinstance(entry.unit, str) else entry.unit
    if names is None:
        if targets.needs_unit(target):
            report.violation(place, expected, ABSENT)
        return (units.si_unit(kind),)
    if len(names) != 1 and target != "time_s":
        report.violation(place, expected, names)
        return (units.si_unit(kind),)
    found = [units.unit_of(kind, name) for name in names]
    for name, unit in zip(names, found, strict=True):
        if unit is None:
            other = units.other_kind(name)
            fix = f"{name} is a unit of {other}." if other else meant(name, known)
            report.violation(place, expected, f'"{name}"', fix)
    return tuple(unit or units.si_unit(kind) for unit in found) or (units.si_unit(kind),)


def _parts(
    entry: AnyEntry, found: tuple[Unit, ...], columns: int, place: Place, report: Translator
) -> tuple[float, ...]:
    """Return the factors, in the first unit, with which the columns of a time are added; none for a single one."""
    dates = [unit.name == units.DATETIME for unit in found]
    if columns < 2 and len(found) < 2:
        return ()
    if len(found) == 1 and dates[0]:
        return (1.0,) * columns
    if len(found) != columns or any(dates):
        expected = 'a unit for each column, like ["s", "ns"], or "datetime" for a date and a time of day'
        report.violation((*place, "unit"), expected, entry.unit)
    return tuple(unit.factor / found[0].factor for unit in found)


def _constants(
    entry: AnyEntry, parts: Sequence[str], unit: Unit, place: Place, report: Translator
) -> list[float | str] | None:
    """Return the constant values in SI; None if the column is measured."""
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
    """Return the source columns, or field paths, of each part."""
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
