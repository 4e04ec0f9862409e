"""Ranges as plain tables (the content of TOML, JSON and YAML) and back; every violation is reported at once."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any, Final, cast

from skincal.errors import InputError, Problem
from skincal.ranges.distributions import DISTRIBUTIONS
from skincal.ranges.names import EFFECTS_PREFIX, TABLES, find
from skincal.ranges.parameter import FIELDS, MODES, SOURCES, Numbers, Parameter
from skincal.ranges.ranges import JointDraws, Ranges
from skincal.ranges.rules import collection_problems, unknown_name

FORMAT: Final = "skincal-ranges/1"

_NUMBERS: Final = ("low", "high", "mean", "sigma", "value")
_REQUIRED: Final = ("distribution", "mode", "source")
_INNER: Final = ("finger", "object", "object.marble", "object.bolt", "skin", "skin.effects")
"""Tables that hold tables."""
_TOP: Final = ("format", "provenance", "finger", "object", "skin")
_JOINT: Final = "skin.joint"
_LARGEST_WHOLE: Final = 2**1000
"""Largest whole number that a float represents exactly."""
_JOINT_KEYS: Final = ("columns", "draws", "mode", "source")

Table = Mapping[str, Any]


def to_plain(ranges: Ranges) -> dict[str, Any]:
    """Return nested tables of strings, floats and lists, without unset figures."""
    plain: dict[str, Any] = {"format": FORMAT}
    if ranges.provenance:
        plain["provenance"] = dict(ranges.provenance)
    for path, parameter in ranges.items():
        _put(plain, path, _plain_parameter(parameter))
    if ranges.joint is not None:
        columns = [path.removeprefix("skin.") for path in ranges.joint.columns]
        table = {"mode": "episode", "source": ranges.joint.source, "columns": columns}
        _put(plain, _JOINT, table | {"draws": ranges.joint.draws.tolist()})
    return plain


def _plain_parameter(parameter: Parameter) -> dict[str, Any]:
    figures: dict[str, Any] = {
        key: list(numbers) if isinstance(numbers, tuple) else numbers
        for key, numbers in parameter.figures().items()
    }
    if parameter.sigma_from is not None:
        figures["sigma_from"] = parameter.sigma_from
    tail = {"mode": parameter.mode, "source": parameter.source}
    return {"distribution": parameter.distribution, **figures, **tail}


def from_plain(values: Table, file: str) -> Ranges:
    """Return ranges from nested tables.

    Args:
        values: the content of a file.
        file: its name, for the messages.

    Raises:
        InputError: listing every violation, with file, table and key.
    """
    place = f"{file}, "
    found = _top_problems(values, place)
    tables = dict(_tables(values, place, found))
    parameters: dict[str, Parameter] = {}
    for path, table in tables.items():
        if path != _JOINT and (parameter := _parameter(path, table, place, found)):
            parameters[path] = parameter
    joint = _joint(values, place, found)
    found += collection_problems(parameters, place, reported=set(tables) - set(parameters))
    if found:
        raise InputError(found)
    return Ranges(parameters, joint, _provenance(values))


def _put(plain: dict[str, Any], path: str, table: dict[str, Any]) -> None:
    *outer, name = path.split(".")
    for key in outer:
        plain = plain.setdefault(key, {})
    plain[name] = table


def _top_problems(values: Table, place: str) -> list[Problem]:
    found: list[Problem] = []
    if values.get("format") != FORMAT:
        got = repr(values["format"]) if "format" in values else "nothing"
        fix = "Another kind of file, or from a newer version of skincal."
        found.append(Problem(f"{place}format", f'"{FORMAT}"', got, fix))
    provenance = values.get("provenance", {})
    if not isinstance(provenance, Mapping) or not all(
        isinstance(v, str) for v in cast(Table, provenance).values()
    ):
        found.append(Problem(f"{place}[provenance]", "a table of texts", str(cast(object, provenance))[:80]))
    return found + _unknown_keys(values, _TOP, place)


def _unknown_keys(table: Table, known: tuple[str, ...], where: str) -> list[Problem]:
    expected = f"one of {', '.join(known)}"
    return [Problem(f"{where}{key}", expected, "an unknown key") for key in table if key not in known]


def _provenance(values: Table) -> dict[str, str]:
    return dict(values.get("provenance", {}))


def _tables(values: Table, place: str, found: list[Problem]) -> Iterator[tuple[str, Table]]:
    """Yield the tables that describe parameters, by full name; add a problem for anything that is not a table."""
    for top in ("finger", "object", "skin"):
        if top in values:
            yield from _inside(top, values[top], place, found)


def _inside(path: str, value: object, place: str, found: list[Problem]) -> Iterator[tuple[str, Table]]:
    if not isinstance(value, Mapping):
        got = str(value)[:80]
        found.append(Problem(f"{place}[{path}]", "a table with distribution, mode, source, and figures", got))
        return
    table = cast(Table, value)
    is_effect = path.startswith(EFFECTS_PREFIX) and path.count(".") == EFFECTS_PREFIX.count(".")
    if path not in _INNER and not is_effect:
        yield path, table
        return
    for key, inner in table.items():
        if path == "object" and f"object.{key}" not in TABLES:
            found.append(
                Problem(f"{place}[object.{key}]", "object.marble or object.bolt", "an unknown object")
            )
        else:
            yield from _inside(f"{path}.{key}", inner, place, found)


def _parameter(path: str, table: Table, place: str, found: list[Problem]) -> Parameter | None:
    """Return a parameter; None, with problems added, where it is invalid."""
    if find(path) is None:
        found.append(unknown_name(path, place))
        return None
    before = len(found)
    where = f"{place}[{path}]"
    found += _unknown_keys(table, FIELDS, f"{where} ")
    found += [
        Problem(f"{where} {key}", _expected(key), "nothing", f"Add {key} = ... to [{path}].")
        for key in _REQUIRED
        if key not in table
    ]
    texts = {key: _text(key, table, where, found) for key in (*_REQUIRED, "sigma_from")}
    numbers = {key: _numbers(key, table, where, found) for key in _NUMBERS}
    if texts["distribution"] is None:
        return None
    # The missing keys have been reported; placeholders let the figures be checked as well.
    texts["mode"], texts["source"] = texts["mode"] or MODES[0], texts["source"] or SOURCES[0]
    try:
        parameter = Parameter(**cast(Any, {**texts, **numbers}))
    except InputError as error:
        # A figure that is not a number has been reported; do not report it as missing, too.
        named = {p.place for p in found[before:]}
        moved = [replace(p, place=p.place.replace("parameter", where, 1)) for p in error.problems]
        found += [p for p in moved if p.place not in named]
        return None
    return parameter if len(found) == before else None


def _expected(key: str) -> str:
    choices = {"distribution": DISTRIBUTIONS, "mode": MODES, "source": SOURCES}
    return f"one of {', '.join(choices[key])}" if key in choices else "a text"


def _text(key: str, table: Table, where: str, found: list[Problem]) -> str | None:
    value = table.get(key)
    if value is not None and not isinstance(value, str):
        found.append(Problem(f"{where} {key}", _expected(key), str(value)[:80]))
        return None
    return value


def _numbers(key: str, table: Table, where: str, found: list[Problem]) -> Numbers | None:
    value = table.get(key)
    if value is None:
        return None
    items = cast("list[object]", value) if isinstance(value, list) else [cast(object, value)]
    if not items or not all(is_number(item) for item in items):
        found.append(
            Problem(f"{where} {key}", "a number, or a list of numbers", repr(cast(object, value))[:80])
        )
        return None
    figures = tuple(float(cast(float, item)) for item in items)
    return figures if isinstance(value, list) else figures[0]


def is_number(value: object) -> bool:
    """Return whether a value of a file is a number; ``true`` is not."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return isinstance(value, float) or abs(value) < _LARGEST_WHOLE


def _joint(values: Table, place: str, found: list[Problem]) -> JointDraws | None:
    """Return the joint draws of ``[skin.joint]``, or None; add problems where the table is invalid."""
    skin = values.get("skin")
    table = cast(Table, skin).get("joint") if isinstance(skin, Mapping) else None
    if not isinstance(table, Mapping):
        return None  # absent, or reported as not a table
    table = cast(Table, table)
    where, before = f"{place}[{_JOINT}]", len(found)
    found += _unknown_keys(table, _JOINT_KEYS, f"{where} ")
    if table.get("mode", "episode") != "episode":
        found.append(Problem(f"{where} mode", "episode", repr(table["mode"])))
    columns, draws = table.get("columns"), table.get("draws")
    if not _is_list_of(columns, str):
        found.append(Problem(f"{where} columns", "a list of names", repr(columns)[:80]))
    if not _are_rows(draws):
        found.append(
            Problem(f"{where} draws", "a list of rows of numbers, all of one length", repr(draws)[:80])
        )
    if len(found) > before:
        return None
    names = [f"skin.{name}" for name in cast("list[str]", columns)]
    try:
        return JointDraws(names, cast("list[list[float]]", draws), table.get("source", "calibrated"))
    except InputError as error:
        found += [replace(p, place=p.place.replace(f"[{_JOINT}]", where, 1)) for p in error.problems]
        return None


def _is_list_of(value: object, kind: type) -> bool:
    return isinstance(value, list) and all(isinstance(item, kind) for item in cast("list[object]", value))


def _are_rows(value: object) -> bool:
    if not _is_list_of(value, list) or not value:
        return False
    rows = cast("list[list[object]]", value)
    return len({len(row) for row in rows}) == 1 and all(is_number(item) for row in rows for item in row)
