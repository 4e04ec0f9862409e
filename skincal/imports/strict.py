"""Tables of a mapping file, in which unknown keys are errors."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, cast

from skincal.dataset.findings import Findings, did_you_mean
from skincal.dataset.toml_table import TomlTable


def as_list(value: Any) -> list[Any]:
    """Return a list as it is, and an empty list for anything else."""
    return cast("list[Any]", value) if isinstance(value, list) else []


def as_table(value: Any) -> dict[str, Any]:
    """Return a table as it is, and an empty table for anything else."""
    return cast("dict[str, Any]", value) if isinstance(value, dict) else {}


class StrictTable(TomlTable):
    """Reader of one table of a mapping file, key by key; unlike in a dataset, unknown keys are errors."""

    @property
    def file(self) -> str:
        """The file's name."""
        return self._file

    @property
    def label(self) -> str:
        """The place of the table."""
        return f"{self._file}, [{self._name}]"

    def texts(self, key: str, expected: str, *, default: tuple[str, ...] | None = None) -> tuple[str, ...]:
        """Return a text, or a list of texts, as a tuple; an empty tuple if it is missing or wrong."""
        value = self.raw(key)
        if value is None:
            if default is None:
                self.text(key, expected)
            return default or ()
        items = as_list(value) or [value]
        if not items or not all(isinstance(item, str) and item for item in items):
            self.error(key, expected, value)
            return ()
        return tuple(items)

    def numbers(self, key: str, expected: str, shape: tuple[int, ...], default: Any) -> Any:
        """Return nested lists of finite numbers of a shape, as nested tuples; the default if missing or wrong."""
        value = self.raw(key)
        if value is None:
            return default
        try:
            return _shaped(value, shape)
        except ValueError:
            self.error(key, expected, value)
            return default

    def bounded(self, key: str, expected: str, default: float, *, low: float = 0.0) -> float:
        """Return a number of at least ``low``; the default if it is missing or wrong."""
        value = self.number(key, expected, default=default, low=low)
        return default if math.isnan(value) else float(value)

    def table(
        self, key: str, known: Sequence[str], findings: Findings, *, strict: bool = True
    ) -> StrictTable:
        """Return a table inside this one; an empty one if it is missing, or, with an error, if it is not a table."""
        values = self.raw(key)
        if values is not None and not isinstance(values, dict):
            self.error(key, "a table", values)
        name = f"{self._name}.{key}" if self._name else key
        content = as_table(values)
        return StrictTable(findings, self._file, name, content, known if strict else tuple(content))

    def items(self) -> Mapping[str, Any]:
        """Return the content of the table."""
        return self._values

    def _report_unknown(self, key: str, candidates: Sequence[str], known: Sequence[str]) -> None:
        close = did_you_mean(key, candidates) or did_you_mean(key, known)
        fix = f'Did you mean "{close}"?' if close else "Remove it."
        self.error(key, f"one of {', '.join(known)}", "an unknown key", fix)


def _shaped(value: Any, shape: tuple[int, ...]) -> Any:
    """Return nested lists as nested tuples.

    Raises:
        ValueError: they have another shape, or hold anything but finite numbers.
    """
    if not shape:
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise ValueError
        return float(value)
    if not isinstance(value, list) or len(cast("list[Any]", value)) != shape[0]:
        raise ValueError
    return tuple(_shaped(item, shape[1:]) for item in cast("list[Any]", value))
