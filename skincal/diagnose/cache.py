"""What a diagnosis worked out once and need not again: the scores of null sessions, and where fits ended.

An entry goes by a hash of everything that it depends on, the program included: of null sessions the protocol (places,
forces, times, phases), the sensor, the noise, the settings; of a fit where it began, too, and what was read. So a
diagnosis that was interrupted goes on where it was, and one of the same presses with the same calibration finds its
null sessions ready. Entries are arrays without code.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, fields, is_dataclass
from functools import cache
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray

from skincal import __version__
from skincal.bounded import UnreadableError, read_arrays
from skincal.model import MeshIndenter, MeshSurface

Arrays = Mapping[str, NDArray[np.float64]]


def default_folder() -> Path:
    """``$SKINCAL_CACHE``, else ``skincal`` in the user's cache."""
    own = os.environ.get("SKINCAL_CACHE")
    if own:
        return Path(own)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "skincal"


@dataclass(frozen=True)
class Cache:
    """A folder of entries; without a folder nothing is kept.

    Attributes:
        folder: where they lie.
        most: entries that are kept; the ones used longest ago go first.
    """

    folder: Path | None = None
    most: int = 200

    def beside(self, name: str, most: int) -> Cache:
        """A cache in a folder of this one, for entries that must not push out those here.

        Args:
            name: of the folder.
            most: entries that are kept there.
        """
        return Cache(None if self.folder is None else self.folder / name, most)

    def get(self, kind: str, parts: Iterable[object], make: Callable[[], Arrays]) -> Arrays:
        """The entry of some parts, made where it is not there.

        A cache that cannot be read or written is done without: it saves time and nothing else. So is one where parts
        are of a kind of which nothing says that it is all in their fields.

        Args:
            kind: of entry; names its file.
            parts: all that it depends on: arrays, numbers, text.
            make: makes it.
        """
        if self.folder is None:
            return make()
        try:
            path = self.folder / f"{kind}-{digest(parts)}.npz"
        except _UnknownPartError:
            return make()
        try:
            found = read_arrays(path)
            path.touch()
            return found
        except (OSError, UnreadableError, MemoryError):  # not there, cut off, or not what was written
            pass
        made = make()
        with suppress(OSError):
            self._put(path, made)
        return made

    def _put(self, path: Path, made: Arrays) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=path.parent, suffix=".tmp")
        try:
            with os.fdopen(handle, "wb") as file:
                np.savez_compressed(file, allow_pickle=False, **made)
            Path(name).replace(path)
        except BaseException:
            Path(name).unlink(missing_ok=True)
            raise
        entries = sorted(path.parent.glob("*.npz"), key=lambda p: p.stat().st_mtime)
        for old in entries[: -self.most]:
            old.unlink(missing_ok=True)


@cache
def _program() -> bytes:
    """What tells this program from another: its version, and the files it is made of; who edits it gets new entries."""
    root = Path(__file__).parent.parent
    told = [
        (str(p.relative_to(root)), p.stat().st_size, p.stat().st_mtime_ns) for p in sorted(root.rglob("*.py"))
    ]
    return repr((__version__, told)).encode()


class _UnknownPartError(TypeError):
    """A part that is not known to be all in what can be hashed of it."""


def digest(parts: Iterable[object]) -> str:
    """A hash of arrays, numbers, text, dataclasses and what holds them, and of the program.

    Raises:
        TypeError: a part of another kind.
    """
    found = hashlib.sha256(_program())
    for part in parts:
        found.update(_bytes(part) + b"\0")
    return found.hexdigest()[:32]


def _bytes(part: object) -> bytes:
    """All of a part; of arrays in a sequence too, the text of which leaves out what is long."""
    if isinstance(part, np.ndarray):
        array = cast("NDArray[np.generic]", part)
        return f"{array.dtype}{array.shape}".encode() + np.ascontiguousarray(array).tobytes()
    if isinstance(part, tuple | list):
        inside = cast("tuple[object, ...] | list[object]", part)
        return b"(" + b",".join(_bytes(one) for one in inside) + b")"
    if isinstance(part, Mapping):
        held = cast("Mapping[object, object]", part)
        return b"{" + b",".join(_bytes(key) + b":" + _bytes(value) for key, value in held.items()) + b"}"
    if is_dataclass(part) and not isinstance(part, type):
        # What two of them are not compared by, they do not depend on.
        own = [getattr(part, one.name) for one in fields(part) if one.compare]
        return type(part).__qualname__.encode() + _bytes(own)
    if isinstance(part, MeshSurface | MeshIndenter):
        return type(part).__qualname__.encode() + _bytes(part.identity)
    if part is None or isinstance(part, str | bool | int | float | np.generic):
        return repr(cast("object", part)).encode()
    raise _UnknownPartError(f"cache: expected arrays, numbers, text or dataclasses of them; got {type(part)}")
