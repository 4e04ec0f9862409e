"""Translation of validation errors to findings: place, expected value, given value, advice."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import Field
from enum import Enum
from typing import Any, cast

from skincal.dataset.findings import Findings, meant
from skincal.dataset.keys import NUMBER, OURS, choice, custom_error

KEPT = "It is kept but not used."
Place = tuple[str | int, ...]
Violation = tuple[str | Place, str, object] | tuple[str | Place, str, object, str]
"""Key, or path of keys; expected value; given value, or words for it; advice (optional)."""


class _Value(Enum):
    ABSENT = 0
    BLANK = 1
    """A wrong value that has been reported and reads as a placeholder (NaN, 0, '', ...)."""


ABSENT, BLANK = _Value.ABSENT, _Value.BLANK

_NATIVE = NUMBER | {
    "int_from_float": "a whole number",
    "bool_type": "true or false",
    "string_type": "a text",
    "tuple_type": "a list, of tables [[{key}]]",
    "dict_type": "a table",
}


def within(table: Place, violations: Iterable[Violation]) -> Iterator[Violation]:
    """Yield violations of a table as those of the file that holds it."""
    for one in violations:
        place, expected, got, fix = in_full(one)
        yield (*table, *place), expected, got, fix


def in_full(violation: Violation) -> tuple[Place, str, object, str]:
    """Return place, expected value, given value and advice of a violation."""
    key, expected, got = violation[:3]
    return (key,) if isinstance(key, str) else key, expected, got, violation[3] if len(violation) > 3 else ""


def missing(key: str, expected: str) -> Violation:
    """Return the violation for a required key that is missing."""
    return key, expected, ABSENT, ""


def superfluous(key: str, reason: str, value: object) -> Violation:
    """Return the violation for a key that is not allowed for a reason."""
    return key, f"no such key: {reason}", value, "Remove it."


def report(
    violations: Iterable[Violation], findings: Findings, file: str, first: int = 1, within: Place = ()
) -> None:
    """Add an error for each violation that was found after reading a file.

    The other arguments are those of :func:`skincal.dataset.schema.read_table`.
    """
    translator = Translator(findings, file, first, within)
    for one in violations:
        translator.violation(*in_full(one))


class Translator:
    """Adds pydantic's errors, and violations between keys, to the findings with their place in a file."""

    def __init__(self, findings: Findings, file: str, first: int = 1, within: Place = ()) -> None:
        self._findings, self._file, self._first, self._within = findings, file, first, within
        self._reported = {problem.place for problem in findings.errors}

    def report(self, error: Any) -> Iterator[Place]:
        """Add a problem for each error; yield the places of wrong values."""
        for one in error.errors(include_url=False):
            details, got = one["ctx"], one["input"]
            key = () if details.get("table") else details["key"]
            table = one["loc"][: len(one["loc"]) - len(key)]
            expected, fix = details["expected"], details["fix"]
            if details.get("table"):
                expected = expected or f"a table [{self._path(table)}]"
                fix = "Add it." if got is ABSENT else f"Write [{self._path(table)}] on its own line."
            elif details.get("number") and isinstance(got, str):
                with suppress(ValueError):
                    float(got)
                    fix = "Write it without quotes."
            words = details.get("got") or shown(got)
            self._add(
                table, key, expected, words, fix or self._add_it(table, key, got),
                warn=details.get("warn", False),
            )  # fmt: skip
            if not details.get("unknown"):
                yield (*table, *key[:1])

    def violation(self, place: Place, expected: str, got: object, fix: str = "") -> None:
        """Add one violation at the last key of a place; ``got`` is a value, or words for it."""
        outer, key = place[:-1], place[-1:]
        words = got if isinstance(got, str) else shown(got)
        # Do not report a missing value where a wrong one was reported and blanked.
        if got is not ABSENT or self._place(outer, key) not in self._reported:
            self._add(outer, key, expected, words, fix or self._add_it(outer, key, got))

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
        """Return a path of keys as text: ``taxels.first``, ``effects 1``."""
        return "".join(f" {k + self._first}" if isinstance(k, int) else f".{k}" for k in keys).lstrip(".")

    def _add_it(self, table: Place, key: Place, got: object) -> str:
        table = (*self._within, *table)
        where = f"[{self._path(table)}]" if table else "the top"
        return f"Add {key[-1]} = … to {where}." if got is ABSENT else ""


def shown(value: Any) -> str:
    """Return a value of a file as an error shows it."""
    if value is ABSENT:
        return "nothing"
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, bool):
        return str(value).lower()
    return str(list(cast("tuple[Any, ...]", value)) if isinstance(value, tuple) else value)


def unknown_key(key: str, value: Any, unknown: str, known: Sequence[str], absent: Sequence[str]) -> Any:
    """Return the error for an unknown key; None if unknown keys are kept.

    ``known`` are all keys of the table, ``absent`` those that it lacks, which are suggested first.
    """
    fix, details = meant(key, absent or known), {"key": (key,), "unknown": True}
    expected = f"one of {', '.join(known)}"
    if unknown == "keep":
        return None
    if unknown == "refuse":
        error = custom_error(
            expected, fix or meant(key, known, "Remove it."), got="an unknown key", **details
        )
    elif fix:
        error = custom_error("a known key", fix, got="an unknown one", **details)
    else:
        error = custom_error(expected, KEPT, got="an unknown key", warn=True, **details)
    return {"type": error, "loc": (key,), "input": value}


def translated_error(one: Any, field: Field[Any]) -> Any:
    """Return a pydantic error with skincal's message; its ``key`` is the place in the innermost table."""
    kind, details = one["type"], dict(one.get("ctx", {}))
    if kind == OURS:
        details = {"key": one["loc"], **details}
    elif kind == "literal_error":
        expected, fix = choice(one["input"], re.findall(r"'(.*?)'", details["expected"]))
        details = {"expected": expected, "fix": fix}
    else:
        optional = kind in NUMBER and field.default is None
        fix = f"Leave {field.name} out where it is not known." if optional else ""
        expected = str(_NATIVE.get(kind) or one["msg"]).replace("{key}", field.name)
        details = {"expected": expected, "fix": fix, "number": kind in NUMBER}
    return {"type": custom_error(**{"key": one["loc"], **details}), "loc": one["loc"], "input": one["input"]}
