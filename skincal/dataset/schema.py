"""Tables of files as frozen dataclasses, validated by pydantic, whose errors are translated to findings.

A subclass of :class:`Table` is both the schema of a table and the object that it is read into: its fields are the
keys, their types are those of the values, and a :class:`Key` in ``Annotated`` adds bounds and messages.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import MISSING, fields
from functools import cache, partial
from pathlib import Path
from types import UnionType
from typing import (
    Annotated,
    Any,
    ClassVar,
    Literal,
    TypeVar,
    Union,
    cast,
    get_args,
    get_origin,
    get_type_hints,
)

from skincal.bounded import UnreadableError, parse_toml, read_text
from skincal.dataset.findings import Findings
from skincal.dataset.keys import Size, custom_error, relaxed
from skincal.dataset.schema_errors import (
    ABSENT,
    BLANK,
    Place,
    Translator,
    Violation,
    in_full,
    shown,
    translated_error,
    unknown_key,
    within,
)
from skincal.files import reason

Unknown = Literal["warn", "refuse", "keep"]
MOST_UNKNOWN = 100
"""Largest number of unknown keys of a table that are reported."""


class Table:
    """Base of a frozen dataclass that is a table of a file; its fields are the keys.

    A field ``extra`` holds unknown keys. The class argument ``unknown`` determines their treatment. ``warn``: a
    misspelt key is an error, any other is kept with a warning; ``keep``: all are kept; ``refuse``: each is an error.
    """

    __pydantic_config__: ClassVar[dict[str, Any]] = {"strict": True, "allow_inf_nan": False}
    unknown_keys: ClassVar[Unknown] = "warn"
    wanted: ClassVar[str] = ""
    """Expected value in the error for a value that is not a table; '' for the table's name."""

    def __init_subclass__(cls, unknown: Unknown | None = None) -> None:
        cls.unknown_keys = unknown or cls.unknown_keys

    def violations(self) -> Iterator[Violation]:
        """Yield inconsistencies between keys; wrong values have been replaced by NaN, 0, '' or an empty container."""
        return iter(())

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: Any) -> Any:
        from pydantic_core import core_schema

        schema = handler(source)
        # Wrap the definition itself, since further uses of the class refer to it.
        definition = handler.resolve_ref_schema(schema)
        inner = relaxed({key: value for key, value in definition.items() if key != "ref"})
        inner["strict"] = False
        hints = get_type_hints(cls, include_extras=True)
        for field in inner["schema"]["fields"]:
            placeholder = _placeholder(hints[field["name"]])
            if field["schema"]["type"] != "default" and placeholder is not BLANK:
                read = partial(_blank_or, placeholder)
                field["schema"] = core_schema.no_info_wrap_validator_function(read, field["schema"])
        read = partial(_read_table, cls)
        wrapped = core_schema.with_info_wrap_validator_function(read, inner, ref=definition.get("ref"))
        definition.clear()
        definition.update(wrapped)
        return schema


Kind = TypeVar("Kind", bound=Table)


def keys_of(kind: type[Table]) -> list[str]:
    """Return the keys that a table may have."""
    return [field.name for field in fields(cast(Any, kind)) if field.name != "extra"]


def load_toml(
    path: Path, findings: Findings, what: str, within: Path | None = None
) -> Mapping[str, Any] | None:
    """Return the content of a TOML file that describes ``what``; None, with an error added, if it cannot be read."""
    try:
        return parse_toml(read_text(path, within=within))
    except FileNotFoundError:
        fix = "" if what == "mapping" else f"Is this a {what}'s folder?"
        findings.error(str(path), f"the description of the {what}", "no such file", fix)
    except UnreadableError as error:
        # The message holds the line and the column.
        fix = "Correct that line: quote texts, put lists in brackets, give every key and table once."
        findings.error(str(path), error.expected, error.got, fix if error.expected == "TOML" else "")
    except OSError as error:
        findings.error(str(path), f"the description of the {what}", reason(error))
    return None


def read_table(
    kind: type[Kind],
    values: Mapping[str, Any],
    findings: Findings,
    file: str,
    form: str = "",
    first: int = 1,
    within: Place = (),
) -> Kind:
    """Return the content of a file as an object; add an error for every violation.

    A wrong value reads as a placeholder (NaN, 0, '', empty), so that the rest can be checked as well. The errors
    prevent the use of placeholders.

    Args:
        kind: class of the object.
        values: content of the file.
        findings: collects the errors.
        file: name of the file, for errors.
        form: required value of the key ``format``; '' for a file without it.
        first: number of the first table of a list in errors.
        within: keys of the table within the file; () for the whole file.
    """
    from pydantic_core import ValidationError

    if form:
        if (given := values.get("format", ABSENT)) != form:
            other = "Another kind of file, or from a newer version of skincal."
            fix = "Add it as the first line." if given is ABSENT else other
            findings.error(f"{file}, format", f'"{form}"', shown(given), fix)
        values = {key: value for key, value in values.items() if key != "format"}
    translator = Translator(findings, file, first, within)
    validate = _validator(kind)
    blanked = dict(values)
    try:
        found = validate(values)
    except ValidationError as error:
        for place in translator.report(error):
            _blank(blanked, place)
        found = validate(blanked, context=BLANK)
    if violations := [*map(in_full, _violations(found, ()))]:
        for violation in violations:
            translator.violation(*violation)
            _blank(blanked, violation[0])
        found = validate(blanked, context=BLANK)
    return found


def _violations(found: Any, place: Place) -> Iterator[Violation]:
    if isinstance(found, tuple | dict):
        inside = found.items() if isinstance(found, dict) else enumerate(found)
        for name, inner in cast("Iterable[tuple[Any, Any]]", inside):
            yield from _violations(inner, (*place, name))
    elif isinstance(found, Table):
        for name in keys_of(type(found)):
            yield from _violations(getattr(found, name), (*place, name))
        yield from within(place, found.violations())


def plain_table(spec: Any) -> dict[str, Any]:
    """Return a table as a dictionary for TOML, without None; a square size is one number."""
    values = {name: getattr(spec, name) for name in keys_of(type(spec))}
    for key, hint in get_type_hints(type(spec), include_extras=True).items():
        is_size = any(isinstance(one, Size) for one in getattr(hint, "__metadata__", ()))
        if is_size and (pair := values[key]) is not None and pair[0] == pair[1]:
            values[key] = pair[0]
    plain = {key: list(v) if isinstance(v, tuple) else v for key, v in values.items() if v is not None}
    return {**plain, **getattr(spec, "extra", {})}


@cache
def _validator(kind: type[Table]) -> Callable[..., Any]:
    from pydantic import TypeAdapter

    return TypeAdapter(kind).validate_python


def _blank(values: dict[str, Any], place: Place) -> None:
    """Put BLANK at a place of nested tables and lists, which are copied on the way."""
    inside: Any = values
    for key, following in zip(place, (*place[1:], None), strict=True):
        inner = inside.get(key) if isinstance(inside, dict) else inside[key]
        if following is None or not isinstance(inner, list if isinstance(following, int) else dict):
            inside[key] = BLANK
            return
        inside[key] = cast("list[Any] | dict[str, Any]", inner).copy()
        inside = inside[key]


def _blank_or(placeholder: Any, value: Any, handler: Callable[[Any], Any]) -> Any:
    return placeholder if value is BLANK else handler(value)


def _placeholder(hint: Any) -> Any:
    """Return the placeholder for a wrong value of a type; BLANK for a table, which has placeholders inside."""
    origin, args = get_origin(hint), get_args(hint)
    if origin in (Annotated, Union, UnionType):
        return _placeholder(args[0])
    if origin is tuple:
        return () if Ellipsis in args else tuple(_placeholder(one) for one in args)
    if origin is Literal:
        return ""
    if isinstance(hint, type) and issubclass(hint, Table):
        return BLANK
    return {int: 0, float: math.nan, str: "", bool: False, dict: {}, Mapping: {}}.get(origin or hint)


def _read_table(cls: type[Any], value: Any, handler: Callable[[Any], Any], info: Any) -> Any:
    """Validate one table; translate unknown and missing keys and the errors of its values."""
    from pydantic_core import ValidationError

    known = {field.name: field for field in fields(cls) if field.name != "extra"}
    needed = {
        name for name, one in known.items() if one.default is MISSING and one.default_factory is MISSING
    }
    absent, value = (BLANK, {}) if value is BLANK else (ABSENT, value)
    if not isinstance(value, Mapping):
        raise custom_error(cls.wanted, table=True)
    table = cast("Mapping[str, Any]", value)
    extra = {key: inner for key, inner in table.items() if key not in known}
    # Optional keys that are missing or wrong get their defaults.
    kept = [name for name in known if name in needed or table.get(name, BLANK) is not BLANK]
    given = {name: table.get(name, absent) for name in kept}
    if len(known) < len(fields(cls)):
        given["extra"] = extra
    free = [name for name in known if name not in table]
    reported = [] if info.context else [*extra][:MOST_UNKNOWN]
    problems = [unknown_key(key, extra[key], cls.unknown_keys, [*known], free) for key in reported]
    try:
        found = handler(given)
    except ValidationError as error:
        problems += [
            translated_error(one, known[str(one["loc"][0])]) for one in error.errors(include_url=False)
        ]
        found = None
    problems = [one for one in problems if one is not None]
    if problems:
        raise ValidationError.from_exception_data(cls.__name__, problems)
    return found
