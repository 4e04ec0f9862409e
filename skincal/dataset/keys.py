"""Constraints on a file's values beyond their types: words, bounds and units, for ``Annotated`` fields of a table."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from datetime import date, datetime
from enum import EnumType
from typing import Any, cast

from skincal.dataset.findings import meant

MILLIMETRES = "It looks like millimetres; the file is in metres: divide by 1000."
TWICE = "It looks as if millimetres were converted to metres twice; multiply by 1000."

OURS = "skincal"
"""Type of the pydantic errors that carry skincal's messages."""

NUMBER = {"float_type": "a number", "finite_number": "a number", "int_type": "a whole number"}
"""Types of pydantic's errors about numbers, with the expected value."""


@dataclass(frozen=True)
class Key:
    """A constraint on a value beyond its type: bounds of its numbers.

    Attributes:
        expected: expected value, for errors.
        low: lower bound of each number.
        high: upper bound of each number.
        inf: True if numbers may be infinite.
    """

    expected: str
    low: float = -math.inf
    high: float = math.inf
    inf: bool = False

    def __get_pydantic_core_schema__(self, source: Any, handler: Callable[[Any], Any]) -> Any:
        from pydantic_core import core_schema

        return core_schema.no_info_wrap_validator_function(self._read, relaxed(handler(source), inf=self.inf))

    def _read(self, value: Any, handler: Callable[[Any], Any]) -> Any:
        from pydantic_core import ValidationError

        try:
            found = handler(self._prepared(value))
        except (ValidationError, ValueError) as error:
            types = [one["type"] for one in error.errors()] if isinstance(error, ValidationError) else []
            raise custom_error(*self._refused(value), number=not NUMBER.keys().isdisjoint(types)) from None
        if (fault := self._fault(found)) is not None:
            raise custom_error(*fault)
        return found

    def _prepared(self, value: Any) -> Any:
        """Return the value in the form of the field's type; raise a ValueError if it cannot be converted."""
        return value

    def _refused(self, value: Any) -> tuple[str, str]:
        """Return the expected value and the advice for a value of another type."""
        return self.expected, ""

    def _fault(self, value: Any) -> tuple[str, str] | None:
        """Return the expected value and the advice for an invalid value of the right type; None if it is valid."""
        return None if self._is_valid(value) else self._refused(value)

    def _is_valid(self, value: Any) -> bool:
        numbers = [*_numbers(value)]
        return all(self.low <= one <= self.high and (self.inf or math.isfinite(one)) for one in numbers)


@dataclass(frozen=True)
class Length(Key):
    """One or several lengths [m] with magnitudes within the bounds; errors suggest a mix-up with millimetres.

    With ``signed`` they may be negative.
    """

    signed: bool = False

    def _fault(self, value: Any) -> tuple[str, str] | None:
        for one in _numbers(value):
            size = abs(one)
            if math.isnan(one) or not (self.signed or one >= 0) or (one == 0 < self.low):
                return self.expected, ""
            if size > self.high and not math.isinf(one):
                bound, meant_m, fix = f"at most {self.high:g} m", size / 1000, MILLIMETRES
            elif size < self.low:
                bound, meant_m, fix = f"at least {self.low:g} m", size * 1000, TWICE
            else:
                continue
            return f"{self.expected}, {bound}", fix if self.low <= meant_m <= self.high else ""
        return None


@dataclass(frozen=True)
class Size(Length):
    """A length [m] for both axes, or a pair ``[du, dv]``."""

    def _prepared(self, value: Any) -> Any:
        return value if isinstance(value, list) or value is None else [value, value]


@dataclass(frozen=True)
class Range(Key):
    """A pair ``[low, high]`` in ascending order with magnitudes up to ``Key.high``.

    Attributes:
        beyond: advice for magnitudes above ``Key.high``.
    """

    beyond: str = ""

    def _fault(self, value: Any) -> tuple[str, str] | None:
        low, high = value
        if not low <= high or not (self.inf or math.isfinite(low + high)):
            return f"{self.expected}, in ascending order", ""
        if any(abs(one) > self.high for one in value if math.isfinite(one)):
            return f"{self.expected}, within ±{self.high:g}", self.beyond
        return None


@dataclass(frozen=True)
class Word(Key):
    """One of some words, or of an enumeration of texts."""

    expected: str = ""
    options: Iterable[str] = ()

    def _prepared(self, value: Any) -> Any:
        return self.options(value) if isinstance(self.options, EnumType) else value

    def _refused(self, value: Any) -> tuple[str, str]:
        return choice(value, self.options)

    def _is_valid(self, value: Any) -> bool:
        return value in self.options


@dataclass(frozen=True)
class Names(Key):
    """A list of unique names."""

    def _is_valid(self, value: Any) -> bool:
        return bool(value) and all(value) and len({*value}) == len(value)


@dataclass(frozen=True)
class Texts(Key):
    """A list of texts; a single text stands for a list of one."""

    def _prepared(self, value: Any) -> Any:
        return [value] if isinstance(value, str) else value

    def _is_valid(self, value: Any) -> bool:
        return value is None or all(value)


@dataclass(frozen=True)
class When(Key):
    """A date or a date with a time, also as a text in ISO 8601."""

    expected: str = "a date and time like 2026-11-20T12:00:00Z"

    def _prepared(self, value: Any) -> Any:
        if not isinstance(value, str | date | None):
            raise ValueError
        return datetime.fromisoformat(value.strip()) if isinstance(value, str) else value


def choice(value: object, options: Iterable[str]) -> tuple[str, str]:
    """Return the expected value and the advice for a value that is none of some words."""
    words = list(options)
    expected = "one of " + ", ".join(f'"{word}"' for word in words)
    return expected, meant(value, words) if isinstance(value, str) else ""


def custom_error(expected: str, fix: str = "", **details: Any) -> Any:
    """Return a pydantic error with skincal's message; ``details`` are read by :mod:`skincal.dataset.schema_errors`."""
    from pydantic_core import PydanticCustomError

    return PydanticCustomError(OURS, "{expected}", {"expected": expected, "fix": fix, **details})


def _numbers(value: Any) -> Iterator[float]:
    """Yield the numbers of a value, which may be nested tuples."""
    if isinstance(value, tuple):
        for one in cast("tuple[Any, ...]", value):
            yield from _numbers(one)
    elif isinstance(value, int | float):
        yield value


def relaxed(schema: Any, *, inf: bool = False) -> Any:
    """Relax a strict pydantic schema in place: accept lists as tuples and dates as times, and infinity if ``inf``."""
    if isinstance(schema, dict):
        if schema.get("type") in ("tuple", "datetime", "union"):
            schema["strict"] = False
        if schema.get("type") == "float" and inf:
            schema["allow_inf_nan"] = True
        for inner in cast("dict[str, Any]", schema).values():
            relaxed(inner, inf=inf)
    elif isinstance(schema, list):
        for inner in cast("list[Any]", schema):
            relaxed(inner, inf=inf)
    return schema
