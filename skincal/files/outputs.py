"""Output that appears complete or not at all, and replaces only earlier output.

Everything is written under a temporary name next to its destination, synced to the disk and moved into place at the
end, so that a full disk, an error, a kill or a loss of power leaves the destination unchanged. Every folder holds a
list of the files written into it; ``--force`` removes a folder only if it holds nothing else.
"""

from __future__ import annotations

import ctypes
import errno
import os
import shutil
import sys
from collections.abc import Callable, Generator, Iterable
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path

from skincal.errors import InputError, input_error
from skincal.files.locks import lock
from skincal.files.manifest import NAME, write_manifest
from skincal.files.refusals import at_work, make_temporary_folder, refuse_existing, refuse_removal
from skincal.signals import held_back


@contextmanager
def whole_folder(
    path: str | Path, *, force: bool = False, marker: str, later: Iterable[str] = ()
) -> Generator[Path]:
    """Yield a temporary folder to write into that becomes ``path`` when the block ends without an error.

    With ``force`` it replaces an earlier output, which the file ``marker`` identifies (see :func:`refuse_existing`).
    ``later`` are names of files that will be written into it later.

    Raises:
        InputError: the destination exists and must not be replaced.
        OSError: the disk is full, or not writable; the destination is unchanged.
    """
    path = Path(path)
    refuse_existing(path, force=force, marker=marker)
    with _temporary(path) as temporary:
        yield temporary
        write_manifest(temporary, later)
        os.umask(mask := os.umask(0))  # the mask of this process, which mkdtemp ignores
        temporary.chmod(0o777 & ~mask)
        with at_work(path, marker if force else None):
            _put(temporary, path, force, marker, "")


@contextmanager
def whole_file(path: str | Path, *, force: bool = False, mark: str = "") -> Generator[Path]:
    """Yield a temporary path, with the suffix of ``path``, whose file becomes ``path`` as :func:`whole_folder` says.

    With ``force`` a file is replaced that holds ``mark``, the text that identifies an earlier output.
    """
    path = Path(path)
    refuse_existing(path, force=force, mark=mark)
    with _temporary(path) as folder:
        yield folder / path.name
        _put(folder / path.name, path, force, None, mark)


@contextmanager
def reserved_room(path: str | Path, size: int) -> Generator[Callable[[], None]]:
    """Keep room for an output of a size [bytes] that is written once its work is done; yield what gives it free.

    Raises:
        OSError: there is not so much room, or no file can be written there.
    """
    with _temporary(Path(path)) as folder:
        file = folder / "room"
        with file.open("wb") as stream:
            stream.write(os.urandom(size))  # zeros would be stored in no room by some file systems
            stream.flush()
            os.fsync(stream.fileno())
        yield partial(file.unlink, missing_ok=True)


@contextmanager
def _temporary(path: Path) -> Generator[Path]:
    """Yield a folder next to an output, locked while this process is at work; errors in it name the output."""
    temporary, descriptor = None, None
    try:
        with held_back():
            while descriptor is None:
                temporary = make_temporary_folder(path)
                with suppress(FileNotFoundError):  # another process considers it abandoned, and removes it
                    descriptor = lock(temporary / NAME, create=True)
        assert temporary is not None
        yield temporary
    except OSError as error:
        name = error.filename
        if error.errno is not None and (name is None or str(name).startswith(str(temporary))):
            error.filename = str(path)
        raise
    finally:
        with held_back():
            if temporary is not None:
                shutil.rmtree(temporary, ignore_errors=True)
            if descriptor is not None:
                os.close(descriptor)


def _put(new: Path, path: Path, force: bool, marker: str | None, mark: str) -> None:
    """Move a finished output to its place, or next to it if that has been taken meanwhile."""
    sync(new)
    try:
        with held_back():
            if force and os.path.lexists(path):
                exchange(new, path, partial(refuse_removal, path, marker=marker, mark=mark))
                return
            try:
                move_new(new, path)
            except OSError:
                if not os.path.lexists(path):
                    raise
                got = f"a {'folder' if path.is_dir() else 'file'} of that name"
                raise input_error(str(path), "nothing there, as when the work began", got) from None
    except InputError as error:
        token = (new.parent if marker is None else new).name.split(".")[-2]
        kept = path.with_name(f"{path.stem}-{token}{path.suffix}")
        move_new(new, kept)
        fix = f"The new output is complete, as {kept}."
        raise InputError([replace(one, fix=fix) for one in error.problems]) from None
    finally:
        # Some network file systems cannot, and a folder may be writable but not readable.
        with suppress(OSError):
            _sync(path.parent)


_LIBC = ctypes.CDLL(None, use_errno=True)
_HERE = -100  # AT_FDCWD: names are relative to the working folder
_NOREPLACE, _EXCHANGE = 1, 2
_LACKING = (errno.ENOSYS, errno.EINVAL, errno.ENOTSUP)
"""Errors of a kernel or a file system without these moves."""


def move_new(source: Path, target: Path) -> None:
    """Move to a name that is free; raise an OSError if it is taken."""
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
    """Replace a path by something new on the same file system; the old content ends up at ``new``, or is gone.

    ``check`` raises an error if the content of a path may not be removed; then nothing changes. It is called again when
    nobody can reach that content any more.
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


def _sync(path: str | Path) -> None:
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _renameat2(source: Path, target: Path, flag: int) -> bool:
    """Return whether the move was done; False if the kernel or the file system cannot do it."""
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
