"""File locks that end with their process, and recovery from killed processes: what they left next to an output."""

from __future__ import annotations

import errno
import fcntl
import logging
import os
import re
import shutil
from collections.abc import Generator
from contextlib import contextmanager, suppress
from pathlib import Path

from skincal.errors import input_error
from skincal.files.manifest import NAME, TEMPORARY
from skincal.signals import held_back

_LACKING = (errno.ENOSYS, errno.ENOTSUP, errno.ENOLCK)
"""Errors of a file system without locks."""


@contextmanager
def alone(file: Path, place: Path, *, create: bool = False) -> Generator[int]:
    """Exclude other processes while a block runs, and yield the descriptor of a lock on a file.

    On a file system without locks nobody is excluded. ``place`` is the output that is worked on, for the error; with
    ``create`` the file is made for the lock, and removed afterwards.

    Raises:
        InputError: another process holds the lock.
        OSError: there is no such file, or it is not writable.
    """
    descriptor = None
    try:
        with held_back():
            descriptor = lock(file, create=create)
        if descriptor is None:
            expected, fix = "no other process at work", "Wait for it, or stop it."
            raise input_error(str(place), expected, "another process at work", fix)
        yield descriptor
    finally:
        with held_back():
            if descriptor is not None:
                if create:
                    file.unlink(missing_ok=True)
                os.close(descriptor)


def lock(file: Path, *, create: bool = False, strict: bool = False) -> int | None:
    """Lock a file, which may be created; return its descriptor, or None if another process holds the lock.

    With ``strict`` a file system without locks is an error.
    """
    # Over NFS, only a file that is open for writing can be locked.
    descriptor = os.open(file, os.O_RDWR | os.O_CLOEXEC | (os.O_CREAT if create else 0), 0o644)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if os.path.samestat(os.fstat(descriptor), file.stat()):
            return descriptor
    except (BlockingIOError, FileNotFoundError):
        pass
    except OSError as error:
        if error.errno in _LACKING and not strict:
            return descriptor
        os.close(descriptor)
        raise
    os.close(descriptor)  # held, or removed while it was being opened
    return None


_log = logging.getLogger("skincal")


def recover(path: Path) -> None:
    """Remove leftovers of killed processes next to an output, and restore an output that was moved away.

    What another process is writing now stays. Actions are logged as warnings.
    """
    named = re.compile(TEMPORARY.format(name=re.escape(path.name)))
    left: list[Path] = []
    with suppress(OSError):
        left = sorted(
            one for one in path.parent.iterdir() if named.fullmatch(one.name) and not one.is_symlink()
        )
    parts = [one for one in left if one.suffix == ".part"]
    swept = [part for part in parts if _remove_abandoned(part)]
    if len(swept) < len(parts):
        return  # another process may be between two moves
    for old in (one for one in left if one.suffix == ".old"):
        if os.path.lexists(path):
            shutil.rmtree(old, ignore_errors=True)
            swept.append(old)
        else:
            old.rename(path)
            _log.warning("%s: restored; an interrupted run had moved it away", path)
    if swept:
        names = ", ".join(one.name for one in swept)
        _log.warning("%s: removed leftovers of interrupted runs: %s", path, names)


def _remove_abandoned(part: Path) -> bool:
    try:
        descriptor = lock(part / NAME, create=True, strict=True)
    except OSError:
        return False
    if descriptor is None:
        return False
    try:
        shutil.rmtree(part, ignore_errors=True)
    finally:
        os.close(descriptor)
    return True
