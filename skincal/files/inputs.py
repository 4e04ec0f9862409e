"""Input files: plain files in the folder where they belong."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path
from typing import BinaryIO

_KINDS = {stat.S_IFIFO: "a pipe", stat.S_IFSOCK: "a socket"}


def real(path: str | Path) -> Path:
    """Return the absolute path without links, also of a loop of links, which fails when it is opened."""
    return Path(os.path.realpath(path))


def check_input(path: str | Path, within: str | Path | None = None) -> Path:
    """Return the resolved path of a file to be read, for libraries that open files by name.

    Args:
        path: the file.
        within: folder that must hold it, for names in another file and for files of an input folder.

    Raises:
        FileNotFoundError: there is no such file.
        IsADirectoryError: it is a folder.
        OSError: it is a device or a pipe, which may never end, or lies outside ``within``.
    """
    if "\0" in str(path):
        raise OSError(errno.EINVAL, "a name with a null character", str(path))
    found = real(path)
    if within is not None and not found.is_relative_to(real(within)):
        raise PermissionError(errno.EACCES, f"outside the folder {within}", str(path))
    _refuse_special(found.stat().st_mode, path)
    return found


def open_input(path: str | Path, within: str | Path | None = None) -> BinaryIO:
    """Open a plain file to read its bytes; arguments as :func:`check_input`.

    Raises:
        OSError: as :func:`check_input` says, or the file is not readable.
    """
    found = check_input(path, within)
    # If the file has been replaced meanwhile, this neither blocks nor follows a link.
    descriptor = os.open(found, os.O_RDONLY | os.O_NONBLOCK | os.O_NOFOLLOW | os.O_CLOEXEC)
    try:
        _refuse_special(os.fstat(descriptor).st_mode, path)
        return os.fdopen(descriptor, "rb")
    except BaseException:
        os.close(descriptor)
        raise


def reason(error: OSError) -> str:
    """Return what went wrong with a file, without its name."""
    return (error.strerror or str(error)).lower()


def _refuse_special(mode: int, path: str | Path) -> None:
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not stat.S_ISREG(mode):
        raise OSError(errno.EINVAL, f"{_KINDS.get(stat.S_IFMT(mode), 'a device')}, not a file", str(path))
