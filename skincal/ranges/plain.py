"""Ranges as plain tables (the content of TOML, JSON and YAML) and back; every violation is reported at once."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, Final, Literal, cast

from skincal.dataset.findings import Findings
from skincal.dataset.keys import Key, Word
from skincal.dataset.schema import Table, read_table
from skincal.errors import InputError, Problem
from skincal.ranges.names import EFFECTS_PREFIX, TABLES, find
from skincal.ranges.parameter import DISTRIBUTIONS, Mode, Parameter, SetFigures, Source
from skincal.ranges.ranges import JointDraws, Ranges
from skincal.ranges.rules import collection_problems, unknown_name
from skincal.ranges.sampling import nested

FORMAT: Final = "skincal-ranges/1"

_INNER: Final = ("finger", "object", "object.marble", "object.bolt", "skin", "skin.effects")
"""Tables that hold tables."""
_JOINT: Final = "skin.joint"

_Tables = Mapping[str, Any]


@dataclass(frozen=True)
class _File(Table, unknown="refuse"):
    provenance: Annotated[Mapping[str, str], Key("a table of texts")] = field(default_factory=dict[str, str])
    finger: _Tables = field(default_factory=dict[str, Any])
    object: _Tables = field(default_factory=dict[str, Any])
    skin: _Tables = field(default_factory=dict[str, Any])


@dataclass(frozen=True)
class _Parameter(SetFigures, Table, unknown="refuse"):
    distribution: Annotated[str, Word(options=DISTRIBUTIONS)]
    mode: Mode
    source: Source


@dataclass(frozen=True)
class _Joint(Table, unknown="refuse"):
    columns: Annotated[tuple[str, ...], Key("a list of names")]
    draws: Annotated[tuple[tuple[float, ...], ...], Key("a list of rows of numbers, all of one length")]
    mode: Literal["episode"] = "episode"
    source: Source = "calibrated"


def to_plain(ranges: Ranges) -> dict[str, Any]:
    """Return nested tables of strings, floats and lists, without unset figures."""
    plain: dict[str, Any] = {"format": FORMAT}
    if ranges.provenance:
        plain["provenance"] = dict(ranges.provenance)
    tables = {path: _plain_parameter(parameter) for path, parameter in ranges.items()}
    if (joint := ranges.joint) is not None:
        columns = [path.removeprefix("skin.") for path in joint.columns]
        table = {"mode": "episode", "source": joint.source, "columns": columns}
        tables[_JOINT] = table | {"draws": joint.draws.tolist()}
    return plain | nested(tables)


def digest(ranges: Ranges) -> str:
    """Return the SHA-256 of what ranges say, whatever file they come from and in whatever order."""
    return hashlib.sha256(json.dumps(to_plain(ranges), sort_keys=True).encode()).hexdigest()


def _plain_parameter(parameter: Parameter) -> dict[str, Any]:
    figures: dict[str, Any] = {
        key: list(numbers) if isinstance(numbers, tuple) else numbers
        for key, numbers in parameter.figures().items()
    }
    if parameter.sigma_from is not None:
        figures["sigma_from"] = parameter.sigma_from
    tail = {"mode": parameter.mode, "source": parameter.source}
    return {"distribution": parameter.distribution, **figures, **tail}


def from_plain(values: Mapping[str, Any], file: str) -> Ranges:
    """Return ranges from nested tables.

    Raises:
        InputError: listing every violation, with file, table and key.
    """
    findings = Findings()
    content = read_table(_File, values, findings, file, FORMAT)
    tables: dict[str, _Tables] = {}
    for top in ("finger", "object", "skin"):
        tables |= _inside(top, getattr(content, top), f"{file}, ", findings)
    parameters: dict[str, Parameter] = {}
    joint = None
    for path, table in tables.items():
        if path == _JOINT:
            joint = _joint(table, file, findings)
        elif find(path) is None:
            findings.errors.append(unknown_name(path, f"{file}, "))
        elif (parameter := _parameter(path, table, file, findings)) is not None:
            parameters[path] = parameter
    reported = set(tables) - set(parameters)
    findings.errors += collection_problems(parameters, f"{file}, ", reported=reported)
    findings.raise_errors()
    return Ranges(parameters, joint, dict(content.provenance))


def _inside(path: str, value: object, place: str, findings: Findings) -> Iterator[tuple[str, _Tables]]:
    if not isinstance(value, Mapping):
        expected = "a table with distribution, mode, source, and figures"
        findings.errors.append(Problem(f"{place}[{path}]", expected, str(value)[:80]))
        return
    table = cast(_Tables, value)
    is_effect = path.startswith(EFFECTS_PREFIX) and path.count(".") == EFFECTS_PREFIX.count(".")
    if path not in _INNER and not is_effect:
        yield path, table
        return
    for key, inner in table.items():
        if path == "object" and f"object.{key}" not in TABLES:
            known = "object.marble or object.bolt"
            findings.error(f"{place}[object.{key}]", known, "an unknown object")
        else:
            yield from _inside(f"{path}.{key}", inner, place, findings)


def _parameter(path: str, table: _Tables, file: str, findings: Findings) -> Parameter | None:
    """Return a parameter; None, with problems added, where it is invalid."""
    before = len(findings.errors)
    found = read_table(_Parameter, table, findings, file, within=(path,))
    if not found.distribution:
        return None
    named = {problem.place for problem in findings.errors[before:]}
    # Placeholders for what has been reported let the figures be checked as well.
    whole = replace(found, mode=found.mode or "episode", source=found.source or "assumed")
    try:
        parameter = Parameter(**vars(whole))
    except InputError as error:
        _move(error, "parameter", f"{file}, [{path}]", named, findings)
        return None
    return None if named else parameter


def _joint(table: _Tables, file: str, findings: Findings) -> JointDraws | None:
    """Return the joint draws of ``[skin.joint]``; None, with problems added, where they are invalid."""
    before = len(findings.errors)
    found = read_table(_Joint, table, findings, file, within=(_JOINT,))
    if len({len(row) for row in found.draws}) != 1 and len(findings.errors) == before:
        findings.error(f"{file}, [{_JOINT}] draws", "rows of numbers, all of one length", "others")
    if len(findings.errors) > before:
        return None
    try:
        return JointDraws((f"skin.{name}" for name in found.columns), found.draws, found.source)
    except InputError as error:
        _move(error, f"[{_JOINT}]", f"{file}, [{_JOINT}]", set(), findings)
        return None


def _move(error: InputError, start: str, place: str, reported: set[str], findings: Findings) -> None:
    """Add the problems of an object, with their place in a file, apart from those reported."""
    moved = (replace(one, place=one.place.replace(start, place, 1)) for one in error.problems)
    findings.errors += [one for one in moved if one.place not in reported]
