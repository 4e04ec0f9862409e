"""Moves of files and folders that no other process, kill or loss of power falls into."""

from __future__ import annotations

import ctypes
import errno
import os
import shutil
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

_LIBC = ctypes.CDLL(None, use_errno=True)
_HERE = -100  # AT_FDCWD: names are relative to the working folder
_NOREPLACE, _EXCHANGE = 1, 2
_LACKING = (errno.ENOSYS, errno.EINVAL, errno.ENOTSUP)
"""What a kernel or a file system without these moves answers."""


def move_new(source: Path, target: Path) -> None:
    """Move to a name that nobody has.

    Raises:
        OSError: something has that name.
    """
    if _renameat2(source, target, _NOREPLACE):
        return
    if source.is_dir():
        os.rename(source, target)  # noqa: PTH104  (fails on whatever is no empty folder)
        return
    try:
        os.link(source, target)
    except OSError:  # taken, or a file system without links
        if os.path.lexists(target):
            raise
        source.rename(target)
    source.unlink(missing_ok=True)


def exchange(new: Path, path: Path, check: Callable[[Path], None]) -> None:
    """Put something new in the place of what is there; what was there lies at ``new`` in the end, or is gone.

    Args:
        new: a file or folder, on the same file system.
        path: where it shall be.
        check: raises an error if what is at a place may not be removed; then nothing has changed. It is asked again
            when nobody can reach that any more.
    """
    check(path)
    if _renameat2(new, path, _EXCHANGE):
        try:
            check(new)
        except BaseException:
            _renameat2(new, path, _EXCHANGE)
            raise
    elif new.is_dir():
        # A process killed in here leaves the name free; `recover` brings what was there back.
        old = new.with_suffix(".old")
        path.rename(old)
        try:
            check(old)
            new.rename(path)
        except BaseException:
            old.rename(path)
            raise
        shutil.rmtree(old, ignore_errors=True)
    else:
        new.replace(path)


def sync(path: Path) -> None:
    """Bring a file, or a folder and all in it, to the disk."""
    for root, _, files in os.walk(path):
        for name in files:
            _sync(os.path.join(root, name))  # noqa: PTH118
        _sync(root)
    if not path.is_dir():
        _sync(path)


def sync_name(path: Path) -> None:
    """Bring the name of a file or folder to the disk."""
    with suppress(OSError):  # some network file systems cannot, and a folder may be writable but not readable
        _sync(path.parent)


def _sync(path: str | Path) -> None:
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _renameat2(source: Path, target: Path, flag: int) -> bool:
    """Whether it was done; False where the kernel or the file system cannot.

    Raises:
        OSError: it failed otherwise.
    """
    call = getattr(_LIBC, "renameat2", None)
    if call is None:
        return False
    sys.audit("os.rename", str(source), str(target), -1, -1)  # as os.rename does
    if call(_HERE, os.fsencode(source), _HERE, os.fsencode(target), flag) == 0:
        return True
    number = ctypes.get_errno()
    if number in _LACKING:
        return False
    raise OSError(number, os.strerror(number), str(source), None, str(target))
