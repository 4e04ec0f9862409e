"""File locks that are released when their process ends, however it ends."""

from __future__ import annotations

import errno
import fcntl
import os
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

from skincal.errors import input_error
from skincal.signals import held_back

_LACKING = (errno.ENOSYS, errno.ENOTSUP, errno.ENOLCK)
"""Errors of a file system without locks."""


@contextmanager
def alone(file: Path, place: Path, *, create: bool = False) -> Generator[int]:
    """Exclude other processes while a block runs, and yield the lock's descriptor.

    On a file system without locks nobody is excluded.

    Args:
        file: the file to lock.
        place: output that is worked on, for the error.
        create: whether to create the file for the lock, and to remove it afterwards.

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
