"""Paths to values inside messages: ``wrench.force.z``, ``position[2]``, ``transforms[child_frame_id=tip].transform``.

A path consists of names with dots between. After a name, ``[3]`` takes an element, and ``[key=word]`` the first
element of a list whose field ``key``, itself a path, is that word.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from skincal.imports.recording import FloatArray

_STEP = re.compile(r"(\w+)(?:\[([^\]]+)\])?(?:\.|$)")


class FieldError(ValueError):
    """A path that a message does not have; the text says where it ends and what exists there."""


class NotHereError(LookupError):
    """A message of the right type without such an element: it gives no sample, and is not an error."""


@dataclass(frozen=True)
class Step:
    """One name of a path, with an optional index, or key and word."""

    name: str
    index: int | None = None
    key: str = ""
    word: str = ""


def parse_path(path: str) -> tuple[Step, ...]:
    """Return the steps of a path.

    Raises:
        FieldError: the text is not a path.
    """
    steps: list[Step] = []
    at = 0
    while at < len(path):
        found = _STEP.match(path, at)
        if not found:
            raise FieldError(f'invalid path from "{path[at:]}" on')
        key, _, word = (found[2] or "").partition("=")
        if found[2] is not None and not word and not key.isdecimal():
            raise FieldError(f'"[{found[2]}]": an index, or a key = word')
        index = int(key) if key and not word else None
        steps.append(Step(found[1], index, key if word else "", word))
        at = found.end()
    if not steps:
        raise FieldError("an empty path")
    return tuple(steps)


def value_at(message: Any, steps: Sequence[Step]) -> Any:
    """Return the value at a path.

    Raises:
        FieldError: a name does not exist.
        NotHereError: an element does not exist.
    """
    for step in steps:
        if step.name not in _names(message):
            raise FieldError(f'no field "{step.name}" in {_described(message)}')
        message = _element(getattr(message, step.name), step)
    return message


def number_at(message: Any, steps: Sequence[Step]) -> float:
    """Return the number at a path; raise as :func:`value_at`, and if the value is not a number."""
    value = value_at(message, steps)
    if isinstance(value, bool | int | float | np.number):
        return float(cast("float", value))
    raise FieldError(f"no number but {_described(value)}")


def array_at(message: Any, steps: Sequence[Step]) -> FloatArray:
    """Return the array of numbers at a path, flat; raise as :func:`value_at`, and if the value is no such array."""
    value = value_at(message, steps)
    try:
        if isinstance(value, str):
            raise ValueError
        return np.asarray(value, dtype=np.float64).ravel()
    except (TypeError, ValueError) as error:
        raise FieldError(f"no array of numbers but {_described(value)}") from error


def _element(value: Any, step: Step) -> Any:
    if step.index is not None:
        if not hasattr(value, "__len__"):
            raise FieldError(f'"{step.name}" has no elements')
        if step.index >= len(value):
            raise NotHereError
        return value[step.index]
    if not step.key:
        return value
    keys = parse_path(step.key)
    for item in value:
        if str(value_at(item, keys)) == step.word:
            return item
    raise NotHereError


def _names(message: Any) -> list[str]:
    """Return the names of the fields of a message; none for a plain value."""
    return list(getattr(message, "__dataclass_fields__", {}))


def _described(value: Any) -> str:
    """Return the type of a value, with its fields."""
    kind, names = getattr(value, "__msgtype__", type(value).__name__), _names(value)
    return f"{kind}, which has {', '.join(names)}" if names else kind
