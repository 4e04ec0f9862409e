"""Ranges files: TOML, JSON or YAML, by the suffix; numbers are read back exactly, and all violations reported."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Final, Literal, cast

import tomli_w
import yaml

from skincal.bounded import UnreadableError, checked, parse_json, parse_toml, parsed, read_text
from skincal.dataset.findings import Findings
from skincal.dataset.keys import Key, Word
from skincal.dataset.schema import Table, read_table
from skincal.errors import InputError, Problem, input_error, readable
from skincal.files import reason, whole_file
from skincal.ranges.names import EFFECTS_PREFIX, TABLES, collection_problems, find, unknown_name
from skincal.ranges.parameter import DISTRIBUTIONS, Mode, Parameter, SetFigures, Source
from skincal.ranges.ranges import JointDraws, Ranges, nested

Plain = dict[str, Any]


class _YamlLoader(yaml.SafeLoader):
    """YAML loader that is safe, refuses duplicate keys, and reads ``2.36e8`` as a number."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        keys: list[object] = [
            self.construct_object(key, deep=True)  # pyright: ignore[reportUnknownMemberType]
            for key, _ in node.value
        ]
        _refuse_twice(keys)
        return super().construct_mapping(node, deep=deep)


# YAML 1.1 requires a point and a signed exponent in a float; people and JSON write neither.
_YamlLoader.add_implicit_resolver(  # pyright: ignore[reportUnknownMemberType]
    "tag:yaml.org,2002:float", re.compile(r"^[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$"), list("-+.0123456789")
)


def _refuse_twice(keys: list[object]) -> None:
    """Refuse a key that occurs twice in one table; the TOML parser does so by itself."""
    seen: set[object] = set()
    for key in keys:
        with suppress(TypeError):  # a list, which YAML's loader refuses as a key
            if key in seen:
                raise ValueError(f"the key {key} twice in one table")
            seen.add(key)


def _json_table(pairs: list[tuple[str, Any]]) -> Plain:
    _refuse_twice([key for key, _ in pairs])
    return dict(pairs)


def _dump_toml(plain: Plain) -> str:
    """Return TOML with one line per draw; the writer's own layout would take one line per figure."""
    skin: Plain = plain.get("skin", {})
    joint: Plain | None = skin.get("joint")
    if joint is None:
        return tomli_w.dumps(plain)
    rest = {**plain, "skin": {key: table for key, table in skin.items() if key != "joint"}}
    head = tomli_w.dumps({"skin": {"joint": {key: v for key, v in joint.items() if key != "draws"}}})
    rows = "".join(f"    [{', '.join(map(repr, row))}],\n" for row in joint["draws"])
    return f"{tomli_w.dumps(rest)}\n{head}draws = [\n{rows}]\n"


_Format = tuple[Callable[[str], object], Callable[[Plain], str]]
_YAML: Final[_Format] = (
    lambda text: checked(parsed("YAML", lambda given: yaml.load(given, _YamlLoader), text)),
    partial(yaml.safe_dump, sort_keys=False, default_flow_style=None, allow_unicode=True, width=100),
)
_FORMATS: Final[dict[str, _Format]] = {
    ".toml": (parse_toml, _dump_toml),
    ".json": (
        partial(parse_json, object_pairs_hook=_json_table),
        lambda plain: json.dumps(plain, indent=2, ensure_ascii=False, allow_nan=False) + "\n",
    ),
    ".yaml": _YAML,
    ".yml": _YAML,
}
"""How a text is read and written, by the suffix."""


def file_format(path: str | Path) -> str:
    """Return the suffix, which decides the format.

    Raises:
        InputError: the suffix is none of ``.toml``, ``.json``, ``.yaml``, ``.yml``.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in _FORMATS:
        got = f'the suffix "{suffix}"' if suffix else "no suffix"
        raise input_error(str(path), f"a file name ending in {', '.join(_FORMATS)}", got)
    return suffix


def read_ranges(path: str | Path) -> Ranges:
    """Read ranges (contract ``skincal-ranges/1``) from a ``.toml``, ``.json``, ``.yaml`` or ``.yml`` file.

    Raises:
        InputError: the file cannot be read, or anything in it is wrong; every violation is listed.
    """
    path = Path(path)
    load, _ = _FORMATS[file_format(path)]
    try:
        values = load(read_text(path))
    except OSError as error:
        raise input_error(str(path), "a ranges file", reason(error)) from error
    except UnreadableError as error:
        # The parser's message holds the line and the column.
        raise input_error(str(path), error.expected, error.got) from error
    if not isinstance(values, Mapping):
        got = type(values).__name__
        raise input_error(str(path), "tables: format, finger, object, skin", f"a {got}")
    return from_plain(cast("Mapping[str, Any]", values), path.name)


def write_ranges(ranges: Ranges, path: str | Path, *, force: bool = False) -> None:
    """Write ranges to a file whose suffix decides the format; it appears complete or not at all.

    Raises:
        InputError: unknown suffix, or the file exists and ``force`` is not given.
        OSError: the disk is full, or not writable.
    """
    _, dump = _FORMATS[file_format(path)]
    with whole_file(path, force=force, mark=FORMAT) as temporary:
        temporary.write_text(readable(dump(to_plain(ranges))), encoding="utf-8")


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
    """Return ranges from nested tables; raise one InputError for all violations, with file, table and key."""
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
    moved = (replace(one, place=one.place.replace(start, place, 1)) for one in error.problems)
    findings.errors += [one for one in moved if one.place not in reported]
