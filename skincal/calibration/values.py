"""Values of a TOML file as numbers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import PurePath
from typing import Any, cast

import numpy as np

from skincal.dataset.toml_table import is_number


def number_list(value: object, *, infinite: bool = False) -> tuple[float, ...] | None:
    """Return a list of numbers as floats; None for anything else.

    Args:
        value: the value as TOML has it.
        infinite: whether -inf and inf are allowed; NaN never is.
    """
    if not isinstance(value, list):
        return None
    items = cast("list[object]", value)
    if not all(is_number(item, infinite=infinite) for item in items):
        return None
    return tuple(float(cast(float, item)) for item in items)


def toml_value(value: Any) -> Any:
    """Return a value as TOML has it: numpy values, tuples and paths are converted, None is left out."""
    if isinstance(value, Mapping):
        items = cast("Mapping[Any, Any]", value).items()
        return {str(key): toml_value(item) for key, item in items if item is not None}
    if isinstance(value, np.ndarray | np.generic):
        return toml_value(cast(Any, value).tolist())
    if isinstance(value, PurePath):
        return str(value)
    if isinstance(value, list | tuple | set | frozenset):
        return [toml_value(item) for item in cast("Iterable[Any]", value)]
    return value


def shown(value: Any) -> str:
    """Return a value for a message, shortened if it is long."""
    text = repr(value)
    return text if len(text) <= 80 else f"{text[:77]}..."
