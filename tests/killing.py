"""Kills a verb at each of its write events, and looks at what is left: whole or absent, and the same when run again.

A write event is a file opened to be written, a name made, moved or removed, or a file brought to the disk. The verb
runs in a fork of this process, which ends at the event without any cleaning up, as a kill ends it.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib
import os
import re
import select
import shutil
import signal
import sys
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from skincal.files import outputs, recover

KILLED = 137
LONGEST_S = 120
"""Time without a write event after which a fork is taken for stuck [s]."""
TIMES = re.compile(rb"\d{4}-\d\d-\d\d[T ]\d\d:\d\d:\d\d[-+.:\dZ]*")
EVENTS = ("os.rename", "os.mkdir", "os.rmdir", "os.remove", "os.link", "os.truncate", "os.chmod")
WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC

Content = dict[str, Any]


def content(path: Path) -> Content:
    """Return the contents of a file or folder without times of day; empty if there is nothing."""
    files = [path] if path.is_file() else [one for one in path.rglob("*") if one.is_file()]
    return {
        one.relative_to(path.parent).as_posix(): hashlib.sha256(TIMES.sub(b"", one.read_bytes())).hexdigest()
        for one in files
    }


@dataclass(frozen=True)
class Verb:
    """Something that writes.

    Attributes:
        name: for messages.
        run: does it, in a folder; it is told whether to replace.
        outputs: names in the folder.
        look: what of an output must come out the same.
        partial: whether an output may also be there in part, as a run that goes on is.
        prepare: makes the inputs in a folder.
    """

    name: str
    run: Callable[[Path, bool], None]
    outputs: tuple[str, ...] = ("out",)
    look: Callable[[Path], Content] = content
    partial: bool = False
    prepare: Callable[[Path], None] = field(default=lambda _: None)


def die() -> None:
    """End as a kill does."""
    os._exit(KILLED)


def forked(
    work: Callable[[], None],
    kill_at: int | None = None,
    root: Path | None = None,
    strike: Callable[[], None] = die,
) -> tuple[int, int]:
    """Run something in a fork; return its exit status and the number of its write events below a folder.

    Args:
        work: what is run.
        kill_at: the event at which the fork ends, before it takes place; None: it runs to the end.
        root: the folder.
        strike: what happens at ``kill_at``.
    """
    read, write = os.pipe()
    child = os.fork()
    if not child:
        status = 1
        try:
            os.close(read)
            quiet = os.open(os.devnull, os.O_WRONLY)
            os.dup2(quiet, 1)
            _count(write, kill_at, str(root), strike)
            work()
            status = 0
        except SystemExit as ended:
            status = ended.code if isinstance(ended.code, int) else 0
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(status)
    os.close(write)
    events = len(read_all(read, child))
    return end_of(child), events


def end_of(child: int) -> int:
    """Wait for the end of a fork, and return its exit status; one that does not end is killed."""
    deadline = time.monotonic() + LONGEST_S
    while (found := os.waitpid(child, os.WNOHANG)) == (0, 0):
        if time.monotonic() > deadline:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            raise AssertionError(f"the fork has not ended for {LONGEST_S} s")
        time.sleep(0.001)
    return os.waitstatus_to_exitcode(found[1])


def read_all(descriptor: int, child: int) -> bytes:
    """Read what a fork writes until it ends; one that does not is killed, so that no test waits for ever."""
    with os.fdopen(descriptor, "rb", buffering=0) as pipe:
        parts = [b""]
        while True:
            if not select.select([pipe], [], [], LONGEST_S)[0]:
                os.kill(child, signal.SIGKILL)
                raise AssertionError(f"the fork has not done anything for {LONGEST_S} s")
            parts.append(pipe.read(1 << 16))
            if not parts[-1]:
                return b"".join(parts)


def preload(work: Callable[[], None], note: Path) -> None:
    """Import what something needs, as a fork that ran it tells in a file, so that no later fork has to."""

    def tell() -> None:
        work()
        note.write_text(" ".join(sys.modules))

    assert forked(tell)[0] == 0
    for name in note.read_text().split():
        with contextlib.suppress(Exception):
            importlib.import_module(name)


def _count(pipe: int, kill_at: int | None, root: str, strike: Callable[[], None]) -> None:
    count = 0

    def event() -> None:
        nonlocal count
        count += 1
        if count == kill_at:
            strike()
        os.write(pipe, b".")

    def hook(name: str, args: tuple[Any, ...]) -> None:
        if name == "open":
            if not (
                isinstance(args[0], (str, bytes, os.PathLike))
                and isinstance(args[2], int)
                and args[2] & WRITING
            ):
                return
        elif name not in EVENTS:
            return
        if isinstance(args[0], (str, bytes, os.PathLike)) and Path(
            os.fsdecode(args[0])
        ).absolute().is_relative_to(root):
            event()

    fsync = os.fsync

    def synced(descriptor: int) -> None:
        if Path(f"/proc/self/fd/{descriptor}").readlink().is_relative_to(root):
            event()
        fsync(descriptor)

    os.fsync = synced
    sys.addaudithook(hook)


@dataclass
class Study:
    """Kills of one verb.

    Args:
        verb: the verb.
        folder: to work in.
        force: whether there is an earlier output, which is replaced.
        exchange: whether the kernel can exchange two names.
    """

    verb: Verb
    folder: Path
    force: bool = False
    exchange: bool = True

    def __post_init__(self) -> None:
        self.base = self.folder / "base"
        self.base.mkdir(parents=True)
        self.verb.prepare(self.base)
        self.given = sorted(path.name for path in self.base.iterdir())
        if self.force:
            assert forked(lambda: self._work(self.base))[0] == 0
        self.before = self._looks(self.base)
        whole = self._copy("whole")
        preload(lambda: self._work(whole), self.folder / "modules")
        whole = self._copy("whole")
        status, self.events = forked(lambda: self._work(whole), None, whole)
        assert status == 0
        self.after = self._looks(whole)
        self._clean(whole)

    def kill(self, at: int) -> None:
        """Kill at an event, look, and run again.

        Raises:
            AssertionError: something is lost, or left over.
        """
        place = self._copy("killed")
        status, _ = forked(lambda: self._work(place), at, place)
        where = (
            f"{self.verb.name}, killed at {at} of {self.events}, force {self.force}, exchange {self.exchange}"
        )
        assert status == KILLED, f"{where}: ended by itself, {status}"
        inputs = {name: content(self.base / name) for name in self.given}
        assert {name: content(place / name) for name in self.given} == inputs, (
            f"{where}: an input has changed"
        )
        if not self.exchange:
            for name in self.verb.outputs:
                recover(place / name)
        for name, found in self._looks(place).items():
            allowed = (self.before[name], self.after[name])
            assert found in allowed or self.verb.partial, f"{where}: {name} is neither whole nor absent"
            assert found or not self.before[name], f"{where}: {name} is lost"
        assert forked(lambda: self._work(place))[0] == 0, f"{where}: could not be run again"
        found = self._looks(place)
        assert found == self.after, f"{where}: run again, it came to something else"
        self._clean(place)
        shutil.rmtree(place)

    def interrupt(self, at: int) -> None:
        """Interrupt at an event, as Ctrl-C does; nothing is left over, as the verb ends by itself.

        Raises:
            AssertionError: something is lost, or left over.
        """
        place = self._copy("interrupted")
        forked(lambda: self._work(place), at, place, lambda: signal.raise_signal(signal.SIGINT))
        for name, found in self._looks(place).items():
            allowed = (self.before[name], self.after[name])
            assert found in allowed, f"{self.verb.name}, interrupted at {at} of {self.events}: {name}"
        self._clean(place)

    def _work(self, place: Path) -> None:
        if not self.exchange:
            outputs._renameat2 = lambda *_: False
        os.chdir(place)
        self.verb.run(place, self.force or any((place / name).exists() for name in self.verb.outputs))

    def _looks(self, place: Path) -> dict[str, Content]:
        return {
            name: self.verb.look(place / name) if (place / name).exists() else {}
            for name in self.verb.outputs
        }

    def _clean(self, place: Path) -> None:
        left = {path.name for path in place.iterdir()} - {*self.given, *self.verb.outputs}
        assert not left, f"{self.verb.name}: {left} are left over"
        hidden = [path for path in place.rglob(".*") if path.name != ".skincal.json"]
        assert not hidden, f"{self.verb.name}: {hidden} are left over"

    def _copy(self, name: str) -> Path:
        shutil.rmtree(self.folder / name, ignore_errors=True)
        return Path(shutil.copytree(self.base, self.folder / name, symlinks=True))
