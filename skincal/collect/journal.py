"""The journal of a session: every finished press, on disk before the next begins, until the output is complete.

A file is written under another name, synced to the disk, and moved into place; after a loss of power a press is
complete or absent.
"""

from __future__ import annotations

import hashlib
import io
import json
import logging
import math
import re
import shutil
from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from skincal.bounded import UnreadableError, parse_json, read_arrays, read_text
from skincal.errors import InputError, Problem, input_error
from skincal.files import alone, whole_file

Arrays = dict[str, NDArray[Any]]
"""Columns by name."""

_log = logging.getLogger("skincal")

HEAD = "session.json"
FORMAT = "skincal-session/1"

_OURS = re.compile(
    r"session\.json|plan\.toml|skin\.memory|(press|rest)-\d+\.npz|connection-\d+\.json|\..*\.part"
)
"""Names of what a session keeps in its folder."""


class Journal:
    """The journal of one session, in a folder.

    Args:
        head: description of the session: all that must be equal to resume it. JSON values only.
    """

    def __init__(self, folder: Path, head: Mapping[str, Any]) -> None:
        self.folder, self.head = folder, dict(head)

    @classmethod
    def open(cls, folder: Path, key: Mapping[str, Any], notes: Mapping[str, Any], *, restart: bool) -> Self:
        """Start a session, or open an interrupted one.

        Args:
            folder: the journal's folder; an ``InputError`` if it holds another session, or something else.
            key: all that must be equal to resume a session, by readable names.
            notes: further information that is stored at the start and may differ.
            restart: whether to discard an earlier session.

        Raises:
            InputError: the folder holds another session, or something else.
        """
        if restart:
            _remove(folder)
        earlier = cls.find(folder)
        if earlier is None:
            journal = cls(folder, {"format": FORMAT, "key": _plain(key), **notes})
            folder.mkdir(parents=True, exist_ok=True)
            _durably(folder / HEAD, json.dumps(journal.head, indent=1).encode())
            return journal
        was, now = earlier.head["key"], _plain(key)
        changed = [name for name in now if was.get(name) != now[name]]
        if not changed and earlier.head.get("format") == FORMAT:
            return earlier
        if not any(folder.glob("*.npz")):
            return cls.open(folder, key, notes, restart=True)  # for instance, the hand was never reached
        raise InputError([_another(folder, was, now, changed, len(earlier.presses()))])

    @classmethod
    def find(cls, folder: Path) -> Self | None:
        """Return the session in a folder; None if there is none.

        Raises:
            InputError: the folder exists, but holds no session.
        """
        if not folder.exists():
            return None
        try:
            head = parse_json(read_text(folder / HEAD))
            datetime.fromisoformat(head["created"])
            if isinstance(head["key"], dict):
                return cls(folder, head)
        except FileNotFoundError:
            if not any(folder.glob("*.npz")):
                return None  # interrupted before it began
        except (OSError, LookupError, TypeError, ValueError):
            pass
        raise _damaged(folder / HEAD, "the description of an interrupted session")

    def presses(self) -> dict[int, Arrays]:
        """Return every finished press by its number."""
        return {int(path.stem.removeprefix("press-")): arrays for path, arrays in self._read("press")}

    def rests(self) -> list[Arrays]:
        """Return the recordings between presses: before the first, after the last, and after interruptions."""
        return [arrays for _, arrays in self._read("rest")]

    def open_end(self, presses: int) -> tuple[list[int], float]:
        """Return the missing ones of so many presses, and the time of the last frame [s]; -inf without one."""
        done = self.presses()
        times = [arrays["frames.time_s"] for arrays in (*done.values(), *self.rests())]
        last_s = max((float(stretch[-1]) for stretch in times if len(stretch)), default=-math.inf)
        return [number for number in range(presses) if number not in done], last_s

    def connections(self) -> list[dict[str, Any]]:
        """Return the starts and resumptions of the session in order: see :meth:`connected`.

        Raises:
            InputError: a file is damaged.
        """
        return [_connection(path) for path in sorted(self.folder.glob("connection-*.json"))]

    def connected(self, what: Mapping[str, Any]) -> None:
        """Record a connection of the hand, with information about it."""
        number = len(self.connections())
        _durably(self.folder / f"connection-{number:04d}.json", json.dumps(dict(what)).encode())

    def keep_press(self, number: int, arrays: Arrays) -> None:
        """Store a finished press; on return it is on the disk."""
        self._keep(f"press-{number:05d}.npz", arrays)

    def keep_rest(self, arrays: Arrays) -> None:
        """Store frames outside of presses."""
        self._keep(f"rest-{len(list(self.folder.glob('rest-*.npz'))):05d}.npz", arrays)

    def keep_text(self, name: str, text: str) -> None:
        """Store a text file."""
        _durably(self.folder / name, text.encode())

    def remove(self) -> None:
        """Remove the folder of a completed session, if it holds nothing else."""
        try:
            _remove(self.folder)
        except InputError as error:
            _log.warning("%s", error)

    def _keep(self, name: str, arrays: Arrays) -> None:
        buffer = io.BytesIO()
        np.savez(buffer, **arrays)  # pyright: ignore[reportArgumentType]
        _durably(self.folder / name, buffer.getvalue())

    def _read(self, kind: str) -> list[tuple[Path, Arrays]]:
        """Return the complete files in the order of their names.

        Raises:
            OSError: one cannot be read at present; it is no reason to press there again, and lose it.
        """
        complete: list[tuple[Path, Arrays]] = []
        for path in sorted(self.folder.glob(f"{kind}-*.npz")):
            if not path.stem.removeprefix(f"{kind}-").isdecimal():
                continue
            try:
                complete.append((path, read_arrays(path)))
            except UnreadableError as error:
                _log.warning("%s is damaged and does not count: %s", path, error)
        return complete


def _connection(path: Path) -> dict[str, Any]:
    try:
        values = parse_json(read_text(path))
        first, shift_s, resumed = int(values["first"]), float(values["shift_s"]), bool(values["resumed"])
        if not math.isfinite(shift_s):
            raise ValueError("shift_s")
        return {**values, "first": first, "shift_s": shift_s, "resumed": resumed}
    except (OSError, ArithmeticError, LookupError, TypeError, ValueError):
        raise _damaged(path, "the resumption of an interrupted session") from None


def _damaged(path: Path, expected: str) -> InputError:
    got = "a damaged file" if path.exists() else "no such file"
    return input_error(str(path), expected, got, "Add --restart to start over; it removes the folder.")


def journal_folder(out: Path) -> Path:
    """Return the journal's folder of a session with output ``out``."""
    return out.parent / f".{out.name}.collect"


def journal_lock(out: Path) -> Path:
    """Return the file that is locked while a session with output ``out`` is at work."""
    return out.parent / f".{out.name}.collect.lock"


def discard_session(out: Path) -> None:
    """Remove what an interrupted session with output ``out`` left.

    Raises:
        InputError: the session is at work, or its folder holds something else.
    """
    folder = journal_folder(out)
    with alone(journal_lock(out), folder, create=True):
        _remove(folder)


def digest_of(text: str) -> str:
    """Return a short hash of a text."""
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _durably(path: Path, content: bytes) -> None:
    """Write a file atomically; on return it is on the disk."""
    with whole_file(path, force=True) as temporary:
        temporary.write_bytes(content)


def _plain(key: Mapping[str, Any]) -> dict[str, Any]:
    """Return the key as JSON gives it back."""
    return json.loads(json.dumps(dict(key)))


def _another(
    folder: Path, was: Mapping[str, Any], now: Mapping[str, Any], changed: list[str], done: int
) -> Problem:
    def shown(key: Mapping[str, Any]) -> str:
        return ", ".join(f"{name} {key.get(name)}" for name in changed)

    return Problem(
        str(folder),
        f"the interrupted session to be this one: {shown(now)}",
        f"another one: {shown(was)}, with {done} finished presses",
        "Give the same options to resume it, --restart to discard it, or another --out.",
    )


def _remove(folder: Path) -> None:
    """Rename the folder first, so that no session with missing presses remains that could be resumed.

    Raises:
        InputError: it holds what no session wrote.
    """
    away = folder.with_name(f"{folder.name}.old")  # there after a kill
    for place in (folder, away):
        names = [path.name for path in place.iterdir()] if place.is_dir() else []
        if strangers := [name for name in names if not _OURS.fullmatch(name)]:
            got = f"also {', '.join(sorted(strangers)[:3])}"
            fix = "Move that elsewhere, or choose another name: only what skincal wrote is removed."
            raise input_error(str(place), "a folder of an interrupted session alone", got, fix)
    shutil.rmtree(away, ignore_errors=True)
    if folder.is_dir():
        folder.replace(away)
        shutil.rmtree(away, ignore_errors=True)
