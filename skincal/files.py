"""Input that is a plain file in its place, and output that appears whole or not at all.

Everything is written beside its destination under a temporary name and moved into place at the end, so a full
disk, an error or an interrupt leaves the destination as it was.
"""

from __future__ import annotations

import errno
import os
import shlex
import shutil
import stat
import tempfile
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from skincal.errors import InputError, Problem

_NOT_THERE = {errno.ENAMETOOLONG: "Choose a shorter name."} | dict.fromkeys(
    (errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOENT),
    "Choose another place, or make the folder writable.",
)
"""What to do where nothing of such a name can be written; ENOENT is what /proc says."""

_KINDS = {stat.S_IFIFO: "a pipe", stat.S_IFSOCK: "a socket"}


def check_input(path: str | Path, within: str | Path | None = None) -> Path:
    """Return where a file to be read lies, links followed.

    For libraries that open files by name; whoever can uses :func:`open_input`.

    Args:
        path: the file.
        within: the folder that must hold it, for names that stand in another file and for files of an input folder.

    Raises:
        FileNotFoundError: there is no such file.
        IsADirectoryError: it is a folder.
        OSError: it is a device or a pipe, which may never end, or lies outside of ``within``.
    """
    if "\0" in str(path):
        raise OSError(errno.EINVAL, "a name with a null character", str(path))
    found = Path(os.path.realpath(path))
    if within is not None and not found.is_relative_to(os.path.realpath(within)):
        raise PermissionError(errno.EACCES, f"outside of the folder {within}", str(path))
    _refuse_special(found.stat().st_mode, path)
    return found


def open_input(path: str | Path, within: str | Path | None = None) -> BinaryIO:
    """Open a plain file to read its bytes.

    Args:
        path: the file.
        within: the folder that must hold it (see :func:`check_input`).

    Raises:
        OSError: as :func:`check_input` says, or the file is not readable.
    """
    found = check_input(path, within)
    # What took the file's place in the meantime neither blocks nor leads elsewhere.
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


def refuse_inputs(path: Path, *read: Path) -> None:
    """Checks that an output does not take the place of what is read, which ``--force`` would delete.

    Args:
        path: the output folder.
        read: folders, or files in them, that are read.

    Raises:
        InputError: the output is one of them, or a folder that holds one.
    """
    out = path.resolve()
    for one in read:
        source = one.resolve()
        folder = source.parent if source.is_file() else source
        if out in (folder, *folder.parents):
            fix = "Choose another name: what is read stays as it is."
            raise InputError(
                [Problem(str(path), "another folder than those that are read", f"that of {one}", fix)]
            )


def refuse_existing(path: Path, *, force: bool, marker: str | None = None) -> None:
    """Checks, before any work is done, that an output may be written.

    Args:
        path: the output file or folder.
        force: whether an existing output may be replaced.
        marker: for a folder, the file that shows it is an earlier output. ``force`` replaces only a folder
            that holds it (or is empty), so that a mistyped path cannot delete somebody's work.

    Raises:
        InputError: it exists and may not be replaced, its parent folder does not exist or may not be written to, or it
            has no name.
    """
    if path.name in ("", ".."):
        raise InputError(
            [Problem(str(path), "a name for the output", "no name, but a place", "Add a name to it.")]
        )
    if not path.parent.is_dir():
        file = next((above for above in path.parents if above.exists() and not above.is_dir()), None)
        got = "no such folder" if file is None else f"{file}, which is a file"
        fix = f"mkdir -p {shlex.quote(str(path.parent))}" if file is None else "Choose another name."
        raise InputError([Problem(str(path), "an output inside an existing folder", got, fix)])
    _refuse_unwritable(path)
    if not (path.exists() or path.is_symlink()):
        return
    if marker is not None and path.is_symlink():
        raise InputError(
            [
                Problem(
                    str(path),
                    "a folder, or nothing yet",
                    f"a link to {path.readlink()}",
                    "Give the folder itself, or another name.",
                )
            ]
        )
    if not force:
        what = "folder" if path.is_dir() else "file"
        raise InputError(
            [
                Problem(
                    str(path),
                    "an output that does not exist yet",
                    f"an existing {what}",
                    "Add --force to replace it.",
                )
            ]
        )
    if marker is None and path.is_dir():
        raise InputError([Problem(str(path), "a file to replace", "a folder", "Choose another name.")])
    if marker is not None and not path.is_dir():
        raise InputError([Problem(str(path), "a folder to replace", "a file", "Choose another name.")])
    if marker is not None and any(path.iterdir()) and not (path / marker).is_file():
        raise InputError(
            [
                Problem(
                    str(path),
                    f"a folder with a {marker}",
                    "a folder of something else",
                    "Choose another name.",
                )
            ]
        )


def _refuse_unwritable(path: Path) -> None:
    """Tries what :func:`whole_folder` will do: no permission tells of names that are too long, or of /proc."""
    try:
        _beside(path, ".part").rmdir()
    except OSError as error:
        fix = _NOT_THERE.get(error.errno or 0)
        if fix is None:  # a full disk, say: no fault of the name
            error.filename = str(path)
            raise
        reason = (error.strerror or str(error)).lower()
        expected = "an output that can be written, its temporary folder beside it"
        raise InputError([Problem(str(path), expected, reason, fix)]) from None


def _beside(path: Path, suffix: str) -> Path:
    """A new temporary folder beside an output."""
    return Path(tempfile.mkdtemp(prefix=f".{path.name}.", suffix=suffix, dir=path.parent))


@contextmanager
def whole_folder(path: str | Path, *, force: bool = False, marker: str) -> Generator[Path]:
    """A folder to write into that becomes ``path`` when the block ends without an error.

    Args:
        path: where the folder shall be.
        force: whether an earlier output there is replaced.
        marker: the file that shows that a folder is an earlier output (see :func:`refuse_existing`).

    Yields:
        The temporary folder.

    Raises:
        InputError: the destination exists, and is not to be replaced.
        OSError: the disk is full, or not writable; the destination is as it was.
    """
    path = Path(path)
    refuse_existing(path, force=force, marker=marker)
    temporary = _beside(path, ".part")
    try:
        yield temporary
        temporary.chmod(0o777 & ~_umask())
        _swap(temporary, path)
    except OSError as error:
        _name(error, temporary, path)
        raise
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


@contextmanager
def whole_file(path: str | Path, *, force: bool = False) -> Generator[Path]:
    """A file to write that becomes ``path`` when the block ends without an error.

    Args:
        path: where the file shall be.
        force: whether an existing file there is replaced.

    Yields:
        The temporary path, with the suffix of ``path``.

    Raises:
        InputError: the destination exists, and is not to be replaced.
        OSError: the disk is full, or not writable; the destination is as it was.
    """
    path = Path(path)
    refuse_existing(path, force=force)
    folder = _beside(path, ".part")
    try:
        yield folder / path.name
        (folder / path.name).replace(path)
    except OSError as error:
        _name(error, folder, path)
        raise
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _swap(temporary: Path, path: Path) -> None:
    """Moves a finished folder to its place; an earlier one is kept until the new one is there."""
    if not path.exists():
        temporary.replace(path)
        return
    old = _beside(path, ".old")
    try:
        path.replace(old)
        try:
            temporary.replace(path)
        except BaseException:
            old.replace(path)
            raise
    finally:
        shutil.rmtree(old, ignore_errors=True)


def _name(error: OSError, temporary: Path, path: Path) -> None:
    """Lets an error name the output that a person asked for, not the temporary one or nothing at all."""
    if error.errno is not None and (error.filename is None or str(error.filename).startswith(str(temporary))):
        error.filename = str(path)


def _umask() -> int:
    """The process's file mode mask; mkdtemp ignores it, an output should not."""
    mask = os.umask(0)
    os.umask(mask)
    return mask
