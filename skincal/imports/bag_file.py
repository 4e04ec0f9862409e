"""ROS bags, opened with the library rosbags, and paths to values inside their messages.

A path, like ``wrench.force.z``, ``position[2]`` or ``transforms[child_frame_id=tip].transform``, consists of names with
dots between. After a name, ``[3]`` takes an element, and ``[key=word]`` the first element of a list whose field
``key``, itself a path, is that word.
"""

from __future__ import annotations

import re
from collections.abc import Generator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np

from skincal.bounded import read_text
from skincal.dataset.findings import Findings, meant
from skincal.errors import InputError, WorkError, input_error, quoted, text_of
from skincal.files import check_input, open_input, reason
from skincal.imports.recording import FloatArray

MISSING = "reading ROS bags needs the library rosbags, which is not installed: pip install skincal[ros]"

OTHER_ENCODINGS = ("json", "protobuf", "flatbuffer", "cbor", "msgpack")
INDEX_BYTES = 1 << 20
"""Number of bytes at the end of an MCAP file that are searched for its index."""


@dataclass(frozen=True)
class Bag:
    """An open bag; ``types`` are those of the messages of each topic."""

    path: Path
    reader: Any
    types: Mapping[str, str]

    def messages(self, topics: set[str]) -> Generator[tuple[str, int, Any]]:
        """Yield topic, time of receipt [ns] and message, in the order of receipt.

        Raises:
            InputError: the bag is damaged, or holds a type that it does not define.
        """
        chosen = [c for c in self.reader.connections if c.topic in topics]
        try:
            for connection, stamp_ns, raw in self.reader.messages(connections=chosen):
                yield connection.topic, stamp_ns, self.reader.deserialize(raw, connection.msgtype)
        except KeyError as error:
            expected = "types that the bag or the mapping defines"
            fix = "Name its file in definitions of [bag]."
            raise input_error(str(self.path), expected, f"no type {error}", fix) from error
        except MemoryError:
            raise
        except Exception as error:  # the library raises whatever its parsers raise
            raise _damaged(self.path, error) from error


@contextmanager
def opened(path: Path, definitions: Mapping[str, Path]) -> Generator[Bag]:
    """Return an open bag: a ROS 1 file (``.bag``), a ROS 2 folder, or one ``.mcap`` or ``.db3`` of such a folder.

    Raises:
        InputError: the path is not a bag, or the bag is damaged.
        WorkError: the library is not installed.
    """
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise WorkError(MISSING) from error
    store: Any = get_typestore(Stores.ROS1_NOETIC if path.suffix == ".bag" else Stores.ROS2_HUMBLE)
    try:
        for file in path.iterdir() if path.is_dir() else [path]:
            check_input(file, within=path if path.is_dir() else None)
    except OSError as error:
        raise input_error(str(error.filename), "a file of a bag", reason(error)) from error
    for name, file in definitions.items():
        store.register(_types(name, file))
    with ExitStack() as stack:
        try:
            reader: Any = stack.enter_context(AnyReader([path], default_typestore=store))
        except MemoryError:
            raise
        except Exception as error:  # the library raises whatever its parsers raise
            raise _damaged(path, error) from error
        # A bag may define only some of its types.
        known = reader.typestore.fielddefs
        reader.typestore.register(
            {name: fields for name, fields in store.fielddefs.items() if name not in known}
        )
        yield Bag(path, reader, {c.topic: c.msgtype for c in reader.connections})


def check_topics(bag: Bag, wanted: Mapping[str, str], findings: Findings) -> bool:
    """Return whether a bag has every topic; for missing topics add errors that list those it has."""
    shown = ", ".join(f"{topic} ({kind})" for topic, kind in sorted(bag.types.items())) or "no topics"
    absent = [topic for topic in wanted if topic not in bag.types]
    for topic in absent:
        expected = f"a topic of {bag.path.name}, which has {shown}"
        findings.error(f"{wanted[topic]} topic", expected, f'"{topic}"', meant(topic, bag.types))
    return not absent


def _types(name: str, file: Path) -> Any:
    """Return the message types of a definition file, ``.msg`` or ``.idl``; raise an InputError for any other."""
    from rosbags.typesys import get_types_from_idl, get_types_from_msg

    try:
        text = read_text(file)
        parts = name.split("/")
        full = name if len(parts) == 3 else f"{parts[0]}/msg/{parts[1]}"
        return get_types_from_idl(text) if file.suffix == ".idl" else get_types_from_msg(text, full)
    except OSError as error:
        raise input_error(str(file), f"the definition of {name}", reason(error)) from error
    except Exception as error:  # the library passes on any exception of its parsers
        raise input_error(str(file), f"the definition of {name}", text_of(error)) from error


def _damaged(path: Path, error: Exception) -> InputError:
    """Return the error of a bag that cannot be read; an MCAP file may hold messages of another encoding than ROS."""
    if path.suffix == ".mcap" and path.is_file() and (encodings := _other_encodings(path)):
        got = f"an MCAP file of {' and '.join(encodings)} messages"
        fix = "Write its channels as .csv or .npz, and use `skincal import csv`."
        return input_error(str(path), "messages of ROS 2 (cdr)", got, fix)
    kind = "ROS 1 bag" if path.suffix == ".bag" else "ROS 2 bag (folder with metadata.yaml)"
    fix = "Was the recording cut short? `rosbag reindex` (ROS 1) or `ros2 bag reindex` may mend it."
    return input_error(str(path), f"a whole {kind}", quoted(error), fix)


def _other_encodings(path: Path) -> list[str]:
    """Return the message encodings of an MCAP file other than ROS; the index at its end names them uncompressed."""
    with open_input(path) as file:
        file.seek(max(path.stat().st_size - INDEX_BYTES, 0))
        tail = file.read()
    return [name for name in OTHER_ENCODINGS if len(name).to_bytes(4, "little") + name.encode() in tail]


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
    """Return the steps of a path; raise a FieldError if the text is none."""
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
    """Return the value at a path; raise a FieldError without such a name, a NotHereError without such an element."""
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
    return list(getattr(message, "__dataclass_fields__", {}))


def _described(value: Any) -> str:
    kind, names = getattr(value, "__msgtype__", type(value).__name__), _names(value)
    return f"{kind}, which has {', '.join(names)}" if names else kind
