"""Ranges files: TOML, JSON or YAML, by the suffix; numbers are read back exactly."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, Final, cast

import tomli_w
import yaml

from skincal.bounded import UnreadableError, checked, parse_json, parse_toml, parsed, read_text
from skincal.errors import input_error, readable
from skincal.files import reason, whole_file
from skincal.ranges.plain import FORMAT, from_plain, to_plain
from skincal.ranges.ranges import Ranges

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


def _dump_yaml(plain: Plain) -> str:
    return yaml.safe_dump(plain, sort_keys=False, default_flow_style=None, allow_unicode=True, width=100)


def _dump_json(plain: Plain) -> str:
    return json.dumps(plain, indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def _load_yaml(text: str) -> object:
    return checked(parsed("YAML", lambda given: yaml.load(given, _YamlLoader), text))


_FORMATS: Final[dict[str, tuple[Callable[[str], object], Callable[[Plain], str]]]] = {
    ".toml": (parse_toml, _dump_toml),
    ".json": (partial(parse_json, object_pairs_hook=_json_table), _dump_json),
    ".yaml": (_load_yaml, _dump_yaml),
    ".yml": (_load_yaml, _dump_yaml),
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
    """Read ranges (contract ``skincal-ranges/1``).

    Args:
        path: a ``.toml``, ``.json``, ``.yaml`` or ``.yml`` file.

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
    """Write ranges; the file appears complete or not at all.

    Args:
        ranges: the ranges.
        path: file to write; its suffix decides the format.
        force: whether to replace an existing file.

    Raises:
        InputError: unknown suffix, or the file exists and ``force`` is not given.
        OSError: the disk is full, or not writable.
    """
    _, dump = _FORMATS[file_format(path)]
    with whole_file(path, force=force, mark=FORMAT) as temporary:
        temporary.write_text(readable(dump(to_plain(ranges))), encoding="utf-8")
