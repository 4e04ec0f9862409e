"""Conversion of command-line text to the annotated type."""

from __future__ import annotations

import types
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, Union, get_args, get_origin

from skincal.bounded import number_in

TRUE, FALSE = ("true", "yes", "on", "1"), ("false", "no", "off", "0")


def converted(value: Any, kind: Any) -> Any:
    """Return a value of a type; anything but text is accepted as it is.

    Text is read as ``int``, ``float``, ``bool``, ``str``, ``Path`` or one of a ``Literal``; ``tuple[T, ...]`` and
    ``Sequence[T]`` as ``A,B,C``, ``Mapping[str, T]`` as ``NAME=A,NAME=B``, and ``T | None`` as T, or ``none``.

    Raises:
        ValueError: the text cannot be converted; the message says what was expected.
    """
    if not isinstance(value, str) or kind is str or kind is Any:
        return value
    origin, arguments = get_origin(kind), get_args(kind)
    if origin in (Union, types.UnionType):
        return _one_of(value, arguments)
    if origin is Literal:
        if value not in arguments:
            raise ValueError(f"one of {', '.join(map(str, arguments))}")
        return value
    parts = [*filter(None, (part.strip() for part in value.split(",")))]
    if _is_a(Mapping, kind):
        return _mapping(parts, (arguments or (str, str))[1])
    if _is_a(Sequence, kind):
        return tuple(converted(part, (arguments or (str,))[0]) for part in parts)
    return _plain(value, kind)


def type_text(kind: Any) -> str:
    """Return the readable name of an annotation."""
    origin, arguments = get_origin(kind), get_args(kind)
    if origin in (Union, types.UnionType):
        return " or ".join(type_text(a) for a in arguments)
    if origin is Literal:
        return " or ".join(map(str, arguments))
    if _is_a(Mapping, kind):
        return f"NAME={type_text((arguments or (str, str))[1])},..."
    if _is_a(Sequence, kind):
        return f"{type_text((arguments or (str,))[0])},..."
    plain = {int: "whole number", float: "number", bool: "true or false", str: "text", Path: "path"}
    return {**plain, type(None): "none"}.get(kind, getattr(kind, "__name__", str(kind)))


def is_text(kind: Any) -> bool:
    """Return whether a value of this type can be given as text; other types are for programs."""
    if get_origin(kind) in (Union, types.UnionType):
        return any(is_text(a) for a in get_args(kind) if a is not type(None))
    plain = kind in (int, float, bool, str, Path, Any) or get_origin(kind) is Literal
    return plain or _is_a(Mapping, kind) or _is_a(Sequence, kind)


def _one_of(value: str, kinds: Sequence[Any]) -> Any:
    if type(None) in kinds and value.lower() == "none":
        return None
    expected: list[str] = []
    # Every text can be read as text: try the other types first.
    for kind in sorted((k for k in kinds if k is not type(None)), key=lambda k: k in (str, Path)):
        try:
            return converted(value, kind)
        except ValueError as error:
            expected.append(str(error))
    raise ValueError(" or ".join(expected))


def _plain(value: str, kind: Any) -> Any:
    if kind is bool:
        if value.lower() not in TRUE + FALSE:
            raise ValueError("true or false")
        return value.lower() in TRUE
    if kind in (int, float):
        return number_in(value, kind)
    if kind is Path:
        return Path(value).expanduser()
    raise ValueError(f"a {type_text(kind)}, which cannot be given as text")


def _mapping(parts: Sequence[str], kind: Any) -> Mapping[str, Any]:
    read: dict[str, Any] = {}
    for part in parts:
        name, equals, text = part.partition("=")
        if not equals:
            raise ValueError("NAME=VALUE,...")
        read[name.strip()] = converted(text.strip(), kind)
    return read


def _is_a(base: type, kind: Any) -> bool:
    own = get_origin(kind) or kind
    return isinstance(own, type) and issubclass(own, base) and own is not str
