"""Tables of files as frozen dataclasses: pydantic validates them, and its errors become ours.

A subclass of :class:`Table` is both the schema of a table and the object that it is read into: its fields are the
keys, their types say what a value must be, and a :class:`Key` in ``Annotated`` adds words and bounds.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import MISSING, Field, fields
from enum import Enum
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
from skincal.dataset.findings import Findings, did_you_mean
from skincal.dataset.keys import NUMBER, OURS, adjusted, choice, wrong
from skincal.files import reason

KEPT = "It is kept but not used."
MOST_UNKNOWN = 100
"""Most unknown keys of a table that are reported."""

Unknown = Literal["warn", "refuse", "keep"]
Place = tuple[str | int, ...]
Violation = tuple[str | Place, str, object] | tuple[str | Place, str, object, str]
"""Key, or keys from table to table; expected; got, a value or words for it; what to do, if that is not clear."""


class _Value(Enum):
    ABSENT = 0
    BLANK = 1
    """Stands for a value that was reported, and reads as a placeholder (NaN, 0, '', ...)."""


ABSENT, BLANK = _Value.ABSENT, _Value.BLANK

_NATIVE = NUMBER | {
    "int_from_float": "a whole number",
    "bool_type": "true or false",
    "string_type": "a text",
    "tuple_type": "a list, of tables [[{key}]]",
    "dict_type": "a table",
}


class Table:
    """Base of a frozen dataclass that is a table of a file; its fields are the keys.

    A field ``extra`` holds unknown keys. ``unknown`` says what becomes of them: ``warn``: a misspelt one is an error,
    another one is kept with a warning; ``keep``: all are kept; ``refuse``: each is an error.
    """

    __pydantic_config__: ClassVar[dict[str, Any]] = {"strict": True, "allow_inf_nan": False}
    unknown_keys: ClassVar[Unknown] = "warn"
    wanted: ClassVar[str] = ""
    """What an error says of a value that is no table; '' for its name."""

    def __init_subclass__(cls, unknown: Unknown | None = None) -> None:
        cls.unknown_keys = unknown or cls.unknown_keys

    def violations(self) -> Iterator[Violation]:
        """Yield what is wrong between keys; placeholders of wrong values are NaN, 0, '' or empty."""
        return iter(())

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: Any) -> Any:
        from pydantic_core import core_schema

        schema = handler(source)
        # The definition itself is wrapped, as further uses of the class refer to it.
        definition = handler.resolve_ref_schema(schema)
        inner = adjusted({key: value for key, value in definition.items() if key != "ref"})
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

    A wrong value reads as a placeholder (NaN, 0, '', empty), so that the rest can be checked as well; the errors
    prevent that a placeholder is used.

    Args:
        kind: the dataclass of the file.
        values: its content.
        findings: collects errors and warnings.
        file: its name.
        form: value of its key ``format``; '' if it has none.
        first: number of the first table of a list.
        within: the table of the file that is read; (): all of it.
    """
    from pydantic_core import ValidationError

    if form:
        _check_format(values.get("format", ABSENT), form, findings, file)
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
    if wrong_keys := [*translator.violations(found, ())]:
        for place in wrong_keys:
            _blank(blanked, place)
        found = validate(blanked, context=BLANK)
    return found


def report(
    violations: Iterable[Violation], findings: Findings, file: str, first: int = 1, within: Place = ()
) -> None:
    """Add an error for each violation that was found after a file was read; arguments as :func:`read_table`."""
    translator = Translator(findings, file, first, within)
    for one in violations:
        translator.violation(*_whole(one))


def plain_table(spec: Any) -> dict[str, Any]:
    """Return a table as TOML writes it, without None; a square size is one number."""
    values = {field.name: getattr(spec, field.name) for field in fields(spec) if field.name != "extra"}
    for key in ("taxel_size_m", "pitch_m"):
        if (pair := values.get(key)) is not None and pair[0] == pair[1]:
            values[key] = pair[0]
    plain = {key: list(v) if isinstance(v, tuple) else v for key, v in values.items() if v is not None}
    return {**plain, **getattr(spec, "extra", {})}


def within(table: Place, violations: Iterable[Violation]) -> Iterator[Violation]:
    """Yield violations of a table as those of the file that holds it."""
    for one in violations:
        place, expected, got, fix = _whole(one)
        yield (*table, *place), expected, got, fix


def _whole(violation: Violation) -> tuple[Place, str, object, str]:
    key, expected, got = violation[:3]
    return (key,) if isinstance(key, str) else key, expected, got, violation[3] if len(violation) > 3 else ""


def missing(key: str, expected: str) -> Violation:
    """Return the violation of a key that is needed in this case."""
    return key, expected, ABSENT, ""


def superfluous(key: str, reason: str, value: object) -> Violation:
    """Return the violation of a key that cannot stand in this case."""
    return key, f"no such key: {reason}", value, "Remove it."


@cache
def _validator(kind: type[Table]) -> Callable[..., Any]:
    from pydantic import TypeAdapter

    return TypeAdapter(kind).validate_python


def _check_format(value: object, form: str, findings: Findings, file: str) -> None:
    if value != form:
        fix = "Another kind of file, or from a newer version of skincal."
        fix = "Add it as the first line." if value is ABSENT else fix
        findings.error(f"{file}, format", f'"{form}"', _shown(value), fix)


class Translator:
    """Reports the errors of pydantic, and violations between keys, with their place in a file.

    Args:
        findings: collects them.
        file: the file's name.
        first: number of the first table of a list.
        within: the table that places begin in.
    """

    def __init__(self, findings: Findings, file: str, first: int = 1, within: Place = ()) -> None:
        self._findings, self._file, self._first, self._within = findings, file, first, within
        self._reported = {problem.place for problem in findings.errors}

    def report(self, error: Any) -> Iterator[Place]:
        """Add a problem for each error; yield the places of wrong values."""
        for one in error.errors(include_url=False):
            told, got = one["ctx"], one["input"]
            key = () if told.get("table") else told["key"]
            table = one["loc"][: len(one["loc"]) - len(key)]
            expected, fix = told["expected"], told["fix"]
            if told.get("table"):
                expected = expected or f"a table [{self._path(table)}]"
                fix = "Add it." if got is ABSENT else f"Write [{self._path(table)}] on its own line."
            elif told.get("number") and isinstance(got, str) and _is_text_of_number(got):
                fix = "Write it without quotes."
            shown = told.get("got") or _shown(got)
            self._add(
                table,
                key,
                expected,
                shown,
                fix or self._add_it(table, key, got),
                warn=told.get("warn", False),
            )
            if not told.get("unknown"):
                yield (*table, *key[:1])

    def violations(self, found: Any, table: Place) -> Iterator[Place]:
        """Add what the tables say is wrong between their keys; yield the places."""
        if isinstance(found, tuple | dict):
            inside = found.items() if isinstance(found, dict) else enumerate(found)
            for name, inner in cast("Iterable[tuple[Any, Any]]", inside):
                yield from self.violations(inner, (*table, name))
        elif isinstance(found, Table):
            for field in fields(cast(Any, found)):
                if field.name != "extra":
                    yield from self.violations(getattr(found, field.name), (*table, field.name))
            for one in within(table, found.violations()):
                place, *_ = told = _whole(one)
                self.violation(*told)
                yield place

    def violation(self, place: Place, expected: str, got: object, fix: str = "") -> None:
        """Add one violation at a key, the last of its place; ``got`` is a value, or words for it."""
        outer, key = place[:-1], place[-1:]
        shown = got if isinstance(got, str) else _shown(got)
        # A wrong value may read as a missing one.
        if got is not ABSENT or self._place(outer, key) not in self._reported:
            self._add(outer, key, expected, shown, fix or self._add_it(outer, key, got))

    def _add(
        self, table: Place, key: Place, expected: str, got: str, fix: str, *, warn: bool = False
    ) -> None:
        place = self._place(table, key)
        self._reported.add(place)
        (self._findings.warn if warn else self._findings.error)(place, expected, got, fix)

    def _place(self, table: Place, key: Place) -> str:
        table = (*self._within, *table)
        named = " ".join(filter(None, (f"[{self._path(table)}]" if table else "", self._path(key))))
        return f"{self._file}, {named}"

    def _path(self, keys: Place) -> str:
        """Return keys from table to table: ``taxels.first``, ``effects 1``."""
        return "".join(f" {k + self._first}" if isinstance(k, int) else f".{k}" for k in keys).lstrip(".")

    def _add_it(self, table: Place, key: Place, got: object) -> str:
        table = (*self._within, *table)
        where = f"[{self._path(table)}]" if table else "the top"
        return f"Add {key[-1]} = … to {where}." if got is ABSENT else ""


def _is_text_of_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _shown(value: Any) -> str:
    if value is ABSENT:
        return "nothing"
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, bool):
        return str(value).lower()
    return str(list(cast("tuple[Any, ...]", value)) if isinstance(value, tuple) else value)


def _blank(values: dict[str, Any], place: Place) -> None:
    """Put BLANK at a place of nested tables and lists, whose copies replace the originals."""
    inside: Any = values
    for key in place[:-1]:
        if isinstance(inside, dict) and not isinstance(inside.get(key), dict | list):
            inside[key] = BLANK
            return
        inside[key] = inside[key].copy()
        inside = inside[key]
    inside[place[-1]] = BLANK


def _blank_or(placeholder: Any, value: Any, handler: Callable[[Any], Any]) -> Any:
    return placeholder if value is BLANK else handler(value)


def _placeholder(hint: Any) -> Any:
    """Return what a value of a type reads as after an error; BLANK for a table, which has placeholders inside."""
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
    """Validate one table; its unknown and missing keys, and the errors of its values, are told in our words."""
    from pydantic_core import ValidationError

    known = {field.name: field for field in fields(cls) if field.name != "extra"}
    needed = [
        k for k, field in known.items() if field.default is MISSING and field.default_factory is MISSING
    ]
    absent = ABSENT
    if value is BLANK:
        value, absent = {}, BLANK
    if not isinstance(value, Mapping):
        raise wrong(cls.wanted, table=True)
    table = cast("Mapping[str, Any]", value)
    extra = {key: inner for key, inner in table.items() if key not in known}
    given = dict.fromkeys(needed, absent) | {
        name: inner
        for name, inner in table.items()
        if name in known and (name in needed or inner is not BLANK)
    }
    if len(known) < len(fields(cls)):
        given["extra"] = extra
    problems = (
        [] if info.context else [_unknown(cls, key, table, [*known]) for key in [*extra][:MOST_UNKNOWN]]
    )
    try:
        found = handler(given)
    except ValidationError as error:
        problems += [_in_our_words(one, known[str(one["loc"][0])]) for one in error.errors(include_url=False)]
        found = None
    problems = [one for one in problems if one is not None]
    if problems:
        raise ValidationError.from_exception_data(cls.__name__, problems)
    return found


def _unknown(cls: type[Table], key: str, table: Mapping[str, Any], known: Sequence[str]) -> Any:
    """Return the error of an unknown key; None where any is welcome."""
    absent = [name for name in known if name not in table] or known
    close, told = did_you_mean(key, absent), {"key": (key,), "unknown": True}
    if cls.unknown_keys == "keep":
        return None
    if cls.unknown_keys == "refuse":
        close = close or did_you_mean(key, known)
        fix = f'Did you mean "{close}"?' if close else "Remove it."
        error = wrong(f"one of {', '.join(known)}", fix, got="an unknown key", **told)
    elif close:
        error = wrong("a known key", f'Did you mean "{close}"?', got="an unknown one", **told)
    else:
        error = wrong(f"one of {', '.join(known)}", KEPT, got="an unknown key", warn=True, **told)
    return {"type": error, "loc": (key,), "input": table[key]}


def _in_our_words(one: Any, field: Field[Any]) -> Any:
    """Return an error of pydantic as one with our words; ``key`` is its place in the innermost table."""
    kind, told = one["type"], dict(one.get("ctx", {}))
    if kind == OURS:
        told = {"key": one["loc"], **told}
    elif kind == "literal_error":
        expected, fix = choice(one["input"], re.findall(r"'(.*?)'", told["expected"]))
        told = {"expected": expected, "fix": fix}
    else:
        optional = kind in NUMBER and field.default is None
        fix = f"Leave {field.name} out where it is not known." if optional else ""
        expected = str(_NATIVE.get(kind) or one["msg"]).replace("{key}", field.name)
        told = {"expected": expected, "fix": fix, "number": kind in NUMBER}
    return {"type": wrong(**{"key": one["loc"], **told}), "loc": one["loc"], "input": one["input"]}
