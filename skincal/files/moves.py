"""Atomic moves of files and folders, safe against other processes, kills and a loss of power."""

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
"""Errors of a kernel or a file system without these moves."""


def move_new(source: Path, target: Path) -> None:
    """Move to a name that is free.

    Raises:
        OSError: the name is taken.
    """
    if _renameat2(source, target, _NOREPLACE):
        return
    if source.is_dir():
        os.rename(source, target)  # noqa: PTH104  (fails on anything but an empty folder)
        return
    try:
        os.link(source, target)
    except OSError:  # taken, or a file system without links
        if os.path.lexists(target):
            raise
        source.rename(target)
    source.unlink(missing_ok=True)


def exchange(new: Path, path: Path, check: Callable[[Path], None]) -> None:
    """Replace a path by something new; the old content ends up at ``new``, or is gone.

    Args:
        new: a file or folder, on the same file system.
        path: path to replace.
        check: raises an error if the content of a path may not be removed; then nothing changes. It is called again
            when nobody can reach that content any more.
    """
    check(path)
    if _renameat2(new, path, _EXCHANGE):
        try:
            check(new)
        except BaseException:
            _renameat2(new, path, _EXCHANGE)
            raise
    elif new.is_dir():
        # A process killed here leaves the name free; `recover` brings the old content back.
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
    """Sync a file, or a folder with its content, to the disk."""
    for root, _, files in os.walk(path):
        for name in files:
            _sync(os.path.join(root, name))  # noqa: PTH118
        _sync(root)
    if not path.is_dir():
        _sync(path)


def sync_name(path: Path) -> None:
    """Sync the name of a file or folder to the disk."""
    with suppress(OSError):  # some network file systems cannot, and a folder may be writable but not readable
        _sync(path.parent)


def _sync(path: str | Path) -> None:
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _renameat2(source: Path, target: Path, flag: int) -> bool:
    """Return whether the move was done; False if the kernel or the file system cannot do it.

    Raises:
        OSError: it failed for another reason.
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
