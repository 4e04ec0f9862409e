"""Bounds on what comes from files and command lines: bytes, nesting, numbers, names and array sizes.

Every reader takes its bytes and its parsed values from here, so that no input can exhaust the memory, the stack or the
range of a float, whatever it holds. What a value means is checked by the reader.
"""

from __future__ import annotations

import csv
import io
import json
import math
import os
import re
import tomllib
import xml.etree.ElementTree as ElementTree
import zipfile
from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any, Final, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from skincal.errors import cut, quoted, text_of
from skincal.files import open_input

MOST_TEXT_BYTES: Final = 8 << 20
"""Of a description, a plan, ranges, a URDF. A plan of 10^4 presses is 2 MB, ranges with 10^4 draws 2 MB."""

MOST_ARRAY_BYTES: Final = 4 << 30
"""Of the arrays in one ``.npz``. The replay buffer of a training run, the largest, is 0.4 GB."""

MOST_MESH_BYTES: Final = 256 << 20
"""Of a mesh: two million triangles of binary STL are 100 MB."""

MOST_NESTING: Final = 32
"""Tables and lists within each other; ours need 6."""

MOST_VALUES: Final = 500_000
"""Values in one description, those that YAML repeats by reference counted each time."""

MOST_KEYS: Final = 20_000
"""Keys of one table; a plan may name a pose for each of its presses."""

MOST_BITS: Final = 63
"""Of a whole number on a command line, without its sign; files hold such numbers in 64."""

MOST_TABLES: Final = 1000
"""Tables with names within one table, like the files or topics of a mapping; each is checked against the others."""

MOST_TAXELS: Final = 1 << 14
"""Of one sensor: 128 x 128, ten times the largest skins that are sold as one array."""

LARGEST: Final = 1e15
"""Larger than any measurement in SI units; below it whole numbers are exact, and squares do not overflow."""

MOST_ROWS: Final = 10_000_000
"""Of a table: a session of 28 hours at 100 Hz; a check and a fit of as many frames take less than 2 GB."""

MOST_COLUMNS: Final = 1 << 15
"""Of a table: the taxels, and as many others."""

_LONG_KEY: Final = re.compile(r"""(?:\.[ \t]*(?:[\w-]+|"[^"\n]*"|'[^'\n]*')[ \t]*){64,}""")
"""A dotted key so long that tomllib takes a time for it that grows with the square of its length."""

Value = TypeVar("Value")
Number = TypeVar("Number", int, float)


class UnreadableError(ValueError):
    """Bytes that are not what they should be, or beyond a bound.

    Attributes:
        expected: what should have been there.
        got: what was there.
    """

    def __init__(self, expected: str, got: str) -> None:
        self.expected, self.got = expected, got
        super().__init__(f"expected {expected}; got {got}")

    def __reduce__(self) -> tuple[type[UnreadableError], tuple[str, str]]:
        """Keep both texts when the error is sent to another process."""
        return type(self), (self.expected, self.got)


def read_bytes(path: Path, most: int = MOST_TEXT_BYTES, within: Path | None = None) -> bytes:
    """The content of a plain file of at most ``most`` bytes, which the folder ``within`` must hold; None: any.

    Raises:
        UnreadableError: it is larger; it is not read to its end then.
        OSError: it cannot be read, is a device or a pipe, or lies outside of ``within``.
    """
    with open_input(path, within) as stream:
        # Python takes the memory for all that it is asked to read before it reads; /proc says that its files are empty.
        size = max(os.fstat(stream.fileno()).st_size, 1 << 16)
        content = stream.read(min(size, most) + 1)
    if len(content) > most:
        raise UnreadableError(f"a file of at most {most >> 20} MiB", "a larger one")
    return content


def read_text(path: Path, within: Path | None = None) -> str:
    """The content of a text file in UTF-8; arguments and errors as :func:`read_bytes` and :func:`decode`."""
    return decode(read_bytes(path, MOST_TEXT_BYTES, within))


def decode(content: bytes) -> str:
    """Bytes as text in UTF-8, without the mark that some editors put at its beginning (a byte order mark).

    Raises:
        UnreadableError: they are none.
    """
    try:
        return content.decode().removeprefix("\ufeff")
    except UnicodeDecodeError as error:
        got = f"byte {error.start}: {error.reason}"
        raise UnreadableError("a readable text file in UTF-8", got) from None


def parse_toml(text: str) -> dict[str, Any]:
    """The tables of a TOML text.

    Raises:
        UnreadableError: it is none, or beyond a bound; the message holds line and column.
    """
    if _LONG_KEY.search(text):
        raise UnreadableError(f"keys of at most {MOST_NESTING} parts", "a longer one")
    return checked(parsed("TOML", tomllib.loads, text))


def parse_json(text: str, *, bits: int = 64, **options: Any) -> Any:
    """The value of a JSON text.

    Raises:
        UnreadableError: it is none, or beyond a bound.
    """
    return checked(parsed("JSON", lambda given: json.loads(given, **options), text), bits)


def parse_xml(text: str) -> ElementTree.Element:
    """The root element of an XML text.

    Raises:
        UnreadableError: it is none, or nested too deep.
    """
    root = parsed("XML", ElementTree.fromstring, text)
    level = [root]
    for _ in range(MOST_NESTING):
        level = [inner for element in level for inner in element]
        if not level:
            return root
    raise UnreadableError(f"elements nested at most {MOST_NESTING} deep", "deeper ones")


def parse_csv(text: str, delimiter: str = ",") -> list[list[str]]:
    """The rows of a CSV text; errors as :func:`parsed`, of a quote that is not closed, or an endless cell."""
    return parsed("CSV", lambda it: list(csv.reader(io.StringIO(it), delimiter=delimiter, strict=True)), text)


def parsed(kind: str, parse: Callable[[str], Value], text: str) -> Value:
    """Return what a parser makes of a text; whatever it raises says that the text is none of its kind.

    Raises:
        UnreadableError: the parser failed.
    """
    try:
        return parse(text)
    except RecursionError:
        raise UnreadableError(
            f"{kind} nested at most {MOST_NESTING} deep", "deeper tables or lists"
        ) from None
    except MemoryError:
        raise
    except Exception as error:  # libraries raise whatever their code runs into
        raise UnreadableError(kind, text_of(error) or type(error).__name__) from error


def checked(value: Value, bits: int = 64) -> Value:
    """A parsed value, if its numbers, its texts, its depth and its size are within the bounds.

    Whole numbers have at most ``bits``. TOML's own bound is 64; all such numbers are floats as well.

    Raises:
        UnreadableError: they are not; the message names the key.
    """
    count = 0
    stack: list[tuple[object, tuple[str, ...]]] = [(value, ())]
    while stack:
        item, place = stack.pop()
        count += 1
        if isinstance(item, Mapping):
            table = cast("Mapping[object, object]", item)
            if not all(isinstance(key, str) for key in table):
                raise _beyond(place, "keys that are texts", "a key that is none")
            if len(table) > MOST_KEYS:
                raise _beyond(place, f"at most {MOST_KEYS} keys in a table", f"{len(table)}")
            if sum(isinstance(inner, Mapping) for inner in table.values()) > MOST_TABLES:
                raise _beyond(place, f"at most {MOST_TABLES} tables in a table", "more")
            stack += [(key, place) for key in table]
            stack += [(inner, (*place, cast(str, key))) for key, inner in table.items()]
        elif isinstance(item, list | tuple):
            stack += [(inner, (*place, str(i))) for i, inner in enumerate(cast("list[object]", item))]
        elif isinstance(item, str):
            _check_text(item, place)
        elif isinstance(item, int) and item.bit_length() > bits:
            raise _beyond(place, f"whole numbers of {bits} bits", f"one of {item.bit_length()} bits")
        if len(place) > MOST_NESTING:
            raise _beyond(place[:3], f"tables and lists nested at most {MOST_NESTING} deep", "deeper ones")
        if count + len(stack) > MOST_VALUES:
            raise _beyond((), f"at most {MOST_VALUES} values", "more")
    return value


def number_in(text: str, kind: type[Number]) -> Number:
    """The number that a text of a command line holds; errors as :func:`check_number`, also where it holds none."""
    try:
        value = kind(text)
    except ValueError:
        raise ValueError("a whole number" if kind is int else "a number") from None
    check_number(value)
    return value


def check_number(value: float) -> None:
    """Checks that a number is finite, and within the bounds of those in files.

    Raises:
        ValueError: it is not; the message says what was expected.
    """
    if isinstance(value, int):
        if value.bit_length() > MOST_BITS:
            raise ValueError(f"a whole number of at most {MOST_BITS} bits")
    elif not abs(value) < LARGEST:
        raise ValueError(f"a number from -{LARGEST:g} to {LARGEST:g}")


def _check_text(text: str, place: tuple[str, ...]) -> None:
    try:
        text.encode()
    except UnicodeEncodeError:
        raise _beyond(place, "text in UTF-8", "half of a surrogate pair") from None


def _beyond(place: tuple[str, ...], expected: str, got: str) -> UnreadableError:
    return UnreadableError(expected, f"{got} in {cut('.'.join(place), 80)}" if place else got)


def read_arrays(
    path: Path, within: Path | None = None, most: int = MOST_ARRAY_BYTES, objects: NDArray[Any] | None = None
) -> dict[str, NDArray[Any]]:
    """The arrays of an ``.npz`` file, by name; nothing in it is executed.

    The folder ``within`` must hold it; None: any. ``objects`` stands for an array of Python objects; None: these are
    refused.

    Raises:
        UnreadableError: it is none, is cut short, or is larger than ``most`` bytes when unpacked.
        OSError: it cannot be read.
    """
    with open_input(path, within) as stream, _whole(".npz"), zipfile.ZipFile(stream) as archive:
        members = archive.infolist()
        if sum(member.file_size for member in members) > most:
            raise UnreadableError(f"arrays of at most {most >> 20} MiB", "larger ones")
        found: dict[str, NDArray[Any]] = {}
        for member in members:
            with archive.open(member) as content:
                found[member.filename.removesuffix(".npy")] = _array(content, member.file_size, objects)
        return found


def read_array(path: Path, objects: NDArray[Any] | None = None) -> NDArray[Any]:
    """The array of an ``.npy`` file; ``objects`` and errors as :func:`read_arrays`."""
    with open_input(path) as stream, _whole(".npy"):
        return _array(stream, min(MOST_ARRAY_BYTES, os.fstat(stream.fileno()).st_size), objects)


@contextmanager
def _whole(kind: str) -> Generator[None]:
    """Whatever a library raises says that a file is not whole."""
    try:
        yield
    except (MemoryError, UnreadableError):
        raise
    except Exception as error:  # zipfile, zlib and numpy have no common class for what they raise
        raise UnreadableError(f"a whole {kind} file", quoted(error)) from error


def _array(stream: IO[bytes], most: int, objects: NDArray[Any] | None) -> NDArray[Any]:
    """One array of at most so many bytes; its header's shape has to be that of the bytes that follow."""
    version = np.lib.format.read_magic(stream)
    read_header = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    shape, by_columns, kind = read_header[version](stream)
    if kind.hasobject:
        if objects is None:
            got = "Python objects, which are not opened as they may run code"
            raise UnreadableError("plain numbers", got)
        return objects
    size = math.prod(shape) * kind.itemsize
    expected = f"numbers of shape {shape}"
    if size > most:
        raise UnreadableError(expected, f"{most} bytes with the header")
    values, read = np.empty(max(size, 0), np.uint8), 0
    while some := stream.read(min(1 << 20, max(size - read, 0))):
        values[read : read + len(some)] = np.frombuffer(some, np.uint8)
        read += len(some)
    if read != size or stream.read(1):
        raise UnreadableError(expected, f"{read} bytes of {kind}" if read < size else "more bytes")
    return values.view(kind).reshape(shape, order="F" if by_columns else "C")


def check_table_size(rows: int, columns: int, most_rows: int = MOST_ROWS) -> None:
    """Checks the size of a table before any of it is read.

    Raises:
        UnreadableError: it is beyond the bounds.
    """
    if rows > most_rows:
        raise UnreadableError(f"at most {most_rows} rows", f"{rows}")
    if columns > MOST_COLUMNS:
        raise UnreadableError(f"at most {MOST_COLUMNS} columns", f"{columns}")


def memory_bytes() -> int:
    """Return the memory of this machine; 16 GiB where the system does not tell."""
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (ValueError, OSError):
        return 16 << 30
