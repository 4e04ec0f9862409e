"""Strict reader of one table of a TOML file: types, choices, bounds, and misspelt keys."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, TypeGuard

import numpy as np
from numpy.typing import NDArray

from skincal.dataset.findings import Findings, did_you_mean
from skincal.dataset.spec import Pair

MILLIMETRES = "It looks like millimetres; the file is in metres: divide by 1000."
TWICE = "It looks as if millimetres were converted to metres twice; multiply by 1000."

KEPT = "It is kept but not used."

MOST_UNKNOWN = 100
"""Most unknown keys of a table that are reported."""

NOT_SET = object()


class TomlTable:
    """Reader of one table of a TOML file, key by key.

    A value that is missing or wrong adds an error and reads as a placeholder (NaN, 0, ''), so that the rest
    can be checked as well; the errors prevent that a placeholder is used.

    Args:
        findings: collects errors and warnings.
        file: the file's name.
        name: the table's name; '' for the top level.
        values: its content.
        known: the keys that it may have.
    """

    def __init__(
        self, findings: Findings, file: str, name: str, values: Mapping[str, Any], known: Sequence[str]
    ) -> None:
        self._findings = findings
        self._file = file
        self._name = name
        self._values = values
        self.extra = {key: value for key, value in values.items() if key not in known}
        missing = [key for key in known if key not in values]
        for key in list(self.extra)[:MOST_UNKNOWN]:
            self._report_unknown(key, missing or known, known)

    def inner(
        self,
        name: str,
        known: Sequence[str],
        *,
        optional: bool = False,
        open_keys: bool = False,
        fix: str = "",
    ) -> TomlTable:
        """Return a table inside this one; an empty one, which reports nothing more, if it is missing or no table.

        Args:
            name: its key.
            known: the keys that it may have.
            optional: whether it may be missing.
            open_keys: whether it may have further keys, without a warning; they are in ``extra``.
            fix: what to do where it is missing.
        """
        values, place = self.raw(name), f"{self._name}.{name}" if self._name else name
        if isinstance(values, dict):
            table = TomlTable(
                self._findings, self._file, place, values, tuple(values) if open_keys else known
            )
            if open_keys:
                table.extra = {key: value for key, value in values.items() if key not in known}
            return table
        where, expected = f"{self._file}, [{place}]", f"a table [{place}]"
        if values is not None:
            self._findings.error(where, expected, values, f"Write [{place}] on its own line.")
        elif not optional:
            self._findings.error(where, expected, "nothing", fix)
        return TomlTable(Findings(), self._file, place, {}, known)

    def place(self, key: str) -> str:
        """Return the place of a key."""
        return f"{self._file}, {f'[{self._name}] ' if self._name else ''}{key}"

    def has(self, key: str) -> bool:
        """Return whether the key is present."""
        return key in self._values

    def error(self, key: str, expected: str, got: object, fix: str = "") -> None:
        """Add an error at a key."""
        self._findings.error(self.place(key), expected, got, fix)

    def number(
        self,
        key: str,
        expected: str = "a number",
        *,
        default: Any = NOT_SET,
        low: float = -math.inf,
        high: float = math.inf,
        inf: bool = False,
    ) -> Any:
        """Return a number within ``[low, high]``; the default if it is missing, NaN if it is wrong."""
        value = self._get(key, default, expected)
        if value is NOT_SET:
            return math.nan
        if not self.has(key):
            return value
        if inf and value == math.inf:
            return value
        if not is_number(value) or not low <= value <= high:
            fix = "" if default is NOT_SET else f"Leave {key} out where it is not known."
            return self._wrong(key, expected, value, math.nan, fix)
        return value

    def length_m(
        self,
        key: str,
        expected: str,
        *,
        low: float,
        high: float,
        positive: bool = True,
        inf: bool = False,
    ) -> float:
        """Return a length [m] within ``[low, high]``; the error says if it is 1000 times too long or short."""
        value = self._get(key, NOT_SET, expected)
        if value is NOT_SET:
            return math.nan
        if not is_number(value, infinite=True) or (positive and value <= 0):
            return self._wrong(key, expected, value, math.nan)
        return self._plausible_length(key, float(value), expected, low, high, inf)

    def _plausible_length(
        self, key: str, value: float, expected: str, low: float, high: float, inf: bool
    ) -> float:
        if math.isinf(value) and value > 0 and inf:
            return value
        if abs(value) > high:
            fix = MILLIMETRES if low <= abs(value) / 1000 <= high else ""
            return self._wrong(key, f"{expected}, at most {high:g} m", value, math.nan, fix)
        if abs(value) < low:
            fix = TWICE if low <= abs(value) * 1000 <= high else ""
            return self._wrong(key, f"{expected}, at least {low:g} m", value, math.nan, fix)
        return value

    def whole(self, key: str, expected: str, *, low: int) -> int:
        """Return a whole number from ``low`` on; 0 if it is missing or wrong."""
        value = self._get(key, NOT_SET, expected)
        if value is NOT_SET:
            return 0
        if not isinstance(value, int) or isinstance(value, bool) or value < low:
            return self._wrong(key, expected, value, 0)
        return value

    def size_m(self, key: str, expected: str, *, low: float, high: float) -> Pair | None:
        """Return a length or a pair ``[du, dv]`` of them [m]; None if it is missing or wrong."""
        value = self._get(key, NOT_SET, expected)
        if value is NOT_SET:
            return None
        pair = value if isinstance(value, list) else [value, value]
        if len(pair) != 2 or not all(is_number(v) and v > 0 for v in pair):
            return self._wrong(key, expected, value, None)
        for length in pair if isinstance(value, list) else pair[:1]:
            if math.isnan(self._plausible_length(key, float(length), expected, low, high, inf=False)):
                return None
        return float(pair[0]), float(pair[1])

    def range(self, key: str, expected: str, *, limit: float, fix: str = "") -> Pair:
        """Return a pair ``[low, high]`` in order, both within ``limit`` of 0; NaN if it is missing or wrong."""
        value = self._get(key, NOT_SET, expected)
        nothing = (math.nan, math.nan)
        if value is NOT_SET:
            return nothing
        if (
            not isinstance(value, list)
            or len(value) != 2
            or not all(is_number(v, infinite=True) for v in value)
        ):
            return self._wrong(key, expected, value, nothing)
        low, high = float(value[0]), float(value[1])
        if not (math.isfinite(low) and math.isfinite(high)) or low > high:
            return self._wrong(key, f"{expected}, in ascending order", value, nothing)
        if max(-low, high) > limit:
            return self._wrong(key, f"{expected}, within ±{limit:g}", value, nothing, fix)
        return low, high

    def choice(self, key: str, options: Sequence[str], *, default: str | None = None) -> Any:
        """Return one of some words; '' if it is missing or wrong."""
        expected = "one of " + ", ".join(f'"{option}"' for option in options)
        value = self._get(key, NOT_SET if default is None else default, expected)
        if value is NOT_SET:
            return ""
        if value not in options:
            close = did_you_mean(value, options) if isinstance(value, str) else None
            return self._wrong(key, expected, value, "", f'Did you mean "{close}"?' if close else "")
        return value

    def flag(self, key: str, *, default: bool) -> bool:
        """Return true or false."""
        value = self._values.get(key, default)
        return value if isinstance(value, bool) else self._wrong(key, "true or false", value, default)

    def text(self, key: str, expected: str, *, default: str | None = None) -> str:
        """Return a text; '' if it is missing or wrong."""
        value = self._get(key, NOT_SET if default is None else default, expected)
        if value is NOT_SET:
            return ""
        return value if isinstance(value, str) else self._wrong(key, expected, value, "")

    def names(self, key: str, expected: str) -> tuple[str, ...]:
        """Return a list of names, each once; an empty one, with an error, if it is missing or wrong."""
        value = self.raw(key)
        names = value if isinstance(value, list) else []
        if not names or not all(isinstance(one, str) and one for one in names) or len({*names}) < len(names):
            self.error(key, expected, "nothing" if value is None else value)
            return ()
        return tuple(names)

    def array(
        self, key: str, count: int, *, low: float = -math.inf, single: bool = True
    ) -> NDArray[np.float64]:
        """Return finite numbers of at least ``low``, shape (count,); NaN if they are missing or wrong.

        Args:
            key: the key.
            count: how many.
            low: the smallest.
            single: whether one number may stand for all.
        """
        value, expected = self.raw(key), f"a number, or a list of {count}" if single else f"a list of {count}"
        numbers = value if isinstance(value, list) else [value] * count if single else []
        if value is None or len(numbers) != count or not all(is_number(one) for one in numbers):
            self.error(key, f"{expected} finite numbers", "nothing" if value is None else value)
        elif any(one < low for one in numbers):
            self.error(key, f"numbers of at least {low:g}", value)
        else:
            return np.array(numbers, dtype=np.float64)
        return np.full(count, np.nan)

    def raw(self, key: str) -> Any:
        """Return the value as it is; None if it is missing."""
        return self._values.get(key)

    def absent(self, key: str, reason: str) -> None:
        """Add an error if the key is present."""
        if self.has(key):
            self.error(key, f"no such key: {reason}", self._values[key], "Remove it.")

    def _get(self, key: str, default: Any, expected: str) -> Any:
        if key in self._values:
            return self._values[key]
        if default is NOT_SET:
            self.error(
                key,
                expected,
                "nothing",
                f"Add {key} = … to {f'[{self._name}]' if self._name else 'the top'}.",
            )
        return default

    def _wrong(self, key: str, expected: str, value: Any, placeholder: Any, fix: str = "") -> Any:
        got = (
            f'"{value}"'
            if isinstance(value, str)
            else str(value).lower()
            if isinstance(value, bool)
            else value
        )
        if isinstance(value, str) and _is_text_of_number(value):
            fix = "Write it without quotes."
        self.error(key, expected, got, fix)
        return placeholder

    def _report_unknown(self, key: str, candidates: Sequence[str], known: Sequence[str]) -> None:
        close = did_you_mean(key, candidates)
        if close:
            self.error(key, "a known key", "an unknown one", f'Did you mean "{close}"?')
            return
        self._findings.warn(self.place(key), f"one of {', '.join(known)}", "an unknown key", KEPT)


def _is_text_of_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def is_number(value: object, *, infinite: bool = False) -> TypeGuard[float]:
    """Return whether a value of a file is a number: finite, or, where allowed, inf or -inf; ``true`` is none."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return not math.isnan(value) if infinite else math.isfinite(value)
