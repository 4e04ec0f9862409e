"""Locks that go with the process that holds them, however it ends."""

from __future__ import annotations

import errno
import fcntl
import os
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

from skincal.errors import InputError, Problem

_LACKING = (errno.ENOSYS, errno.ENOTSUP, errno.ENOLCK)
"""What a file system without locks answers."""


@contextmanager
def alone(file: Path, place: Path, *, create: bool = False) -> Generator[None]:
    """Keep other processes away from what a file stands for; where the file system has no locks, hope for the best.

    Args:
        file: the file to lock.
        place: what is worked at, for the error.
        create: whether the file is made for the lock, and removed with it.

    Raises:
        InputError: another process holds it.
        OSError: there is no such file, or it is not writable.
    """
    descriptor = lock(file, create=create)
    if descriptor is None:
        fix = "Wait for it, or stop it."
        raise InputError([Problem(str(place), "nobody else at work", "another process at work", fix)])
    try:
        yield
    finally:
        if create:
            file.unlink(missing_ok=True)
        os.close(descriptor)


def lock(file: Path, *, create: bool = False, strict: bool = False) -> int | None:
    """Lock a file; return its descriptor, and None where another process holds it.

    Args:
        file: the file to lock.
        create: whether it may be made.
        strict: whether a file system without locks is an error.
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
