"""Output that appears whole or not at all, and takes the place of nothing but earlier output.

Everything is written beside its destination under a temporary name, brought to the disk and moved into place at the
end, so a full disk, an error, a kill or a loss of power leaves the destination as it was. Every folder holds a list of
what was written into it; ``--force`` removes a folder only where it holds nothing else.
"""

from __future__ import annotations

import errno
import os
import shlex
import shutil
import tempfile
from collections.abc import Generator, Iterable
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path

from skincal.errors import InputError, Problem
from skincal.files.inputs import open_input
from skincal.files.locks import alone, lock
from skincal.files.manifest import NAME, holds, strangers, write_manifest
from skincal.files.moves import exchange, move_new, sync, sync_name
from skincal.files.recovery import recover

_NOT_THERE = {errno.ENAMETOOLONG: "Choose a shorter name."} | dict.fromkeys(
    (errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOENT),
    "Choose another place, or make the folder writable.",
)
"""What to do where nothing of such a name can be written; ENOENT is what /proc says."""

_SHOWN = 3
_ENDS = 4096
"""Bytes at both ends of a file in which its mark is looked for."""


def refuse_existing(
    path: Path, *inputs: Path, force: bool, marker: str | None = None, mark: str = ""
) -> None:
    """Check, before any work is done, that an output may be written; sweep what a killed run left beside it.

    Args:
        path: the output file or folder.
        inputs: files and folders that are read, none of which the output may replace.
        force: whether an existing output may be replaced.
        marker: for a folder, the file that shows what it is an earlier output of. ``force`` replaces only a folder
            that holds it (or is empty) and nothing that skincal did not write, so that a mistyped path cannot delete
            somebody's work.
        mark: for a file, what an earlier output holds; ``force`` replaces no other file.

    Raises:
        InputError: it exists and may not be replaced, its parent folder does not exist or may not be written to, or it
            has no name.
    """
    if path.name in ("", ".."):
        raise _problem(path, "a name for the output", "no name, but a place", "Add a name to it.")
    if not path.parent.is_dir():
        file = next((above for above in path.parents if above.exists() and not above.is_dir()), None)
        got = "no such folder" if file is None else f"{file}, which is a file"
        fix = f"mkdir -p {shlex.quote(str(path.parent))}" if file is None else "Choose another name."
        raise _problem(path, "an output inside an existing folder", got, fix)
    _refuse_unwritable(path)
    for one in inputs:
        _refuse_input(path, one)
    recover(path)
    if not os.path.lexists(path):
        return
    if not force and not (marker is not None and path.is_symlink()):
        what = "folder" if path.is_dir() else "file"
        fix = "Add --force to replace it."
        raise _problem(path, "an output that does not exist yet", f"an existing {what}", fix)
    _refuse_removal(path, path, marker, mark)
    with _at_work(path, marker):
        pass


@contextmanager
def whole_folder(
    path: str | Path, *, force: bool = False, marker: str, later: Iterable[str] = ()
) -> Generator[Path]:
    """A folder to write into that becomes ``path`` when the block ends without an error.

    Args:
        path: where the folder shall be.
        force: whether an earlier output there is replaced.
        marker: the file that shows that a folder is an earlier output (see :func:`refuse_existing`).
        later: names of files that will be written into it later.

    Yields:
        The temporary folder.

    Raises:
        InputError: the destination exists, and is not to be replaced.
        OSError: the disk is full, or not writable; the destination is as it was.
    """
    path = Path(path)
    refuse_existing(path, force=force, marker=marker)
    with _temporary(path) as temporary:
        yield temporary
        write_manifest(temporary, later)
        temporary.chmod(0o777 & ~_umask())
        with _at_work(path, marker if force else None):
            _put(temporary, path, force, marker, "")


@contextmanager
def whole_file(path: str | Path, *, force: bool = False, mark: str = "") -> Generator[Path]:
    """A file to write that becomes ``path`` when the block ends without an error.

    Args:
        path: where the file shall be.
        force: whether an existing file there is replaced.
        mark: text that an earlier output holds; no other file is replaced.

    Yields:
        The temporary path, with the suffix of ``path``.

    Raises:
        InputError: the destination exists, and is not to be replaced.
        OSError: the disk is full, or not writable; the destination is as it was.
    """
    path = Path(path)
    refuse_existing(path, force=force, mark=mark)
    with _temporary(path) as folder:
        yield folder / path.name
        _put(folder / path.name, path, force, None, mark)


@contextmanager
def _temporary(path: Path) -> Generator[Path]:
    """A folder beside an output, locked as long as this process is at work; an error in it names the output."""
    temporary = _beside(path)
    descriptor = None
    try:
        while descriptor is None:
            with suppress(FileNotFoundError):
                descriptor = lock(temporary / NAME, create=True)
            if descriptor is None:  # another process took it for abandoned, and removes it
                temporary = _beside(path)
        yield temporary
    except OSError as error:
        name = error.filename
        if error.errno is not None and (name is None or str(name).startswith(str(temporary))):
            error.filename = str(path)
        raise
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
        if descriptor is not None:
            os.close(descriptor)


def _put(new: Path, path: Path, force: bool, marker: str | None, mark: str) -> None:
    """Move a finished output to its place; where that has been taken meanwhile, beside it."""
    sync(new)
    try:
        if force and os.path.lexists(path):
            exchange(new, path, partial(_refuse_removal, path, marker=marker, mark=mark))
        else:
            _move_new(new, path)
    except InputError as error:
        token = (new.parent if marker is None else new).name.split(".")[-2]
        kept = path.with_name(f"{path.stem}-{token}{path.suffix}")
        move_new(new, kept)
        raise InputError(
            [replace(one, fix=f"The new one is whole, as {kept}.") for one in error.problems]
        ) from None
    finally:
        sync_name(path)


def _move_new(new: Path, path: Path) -> None:
    try:
        move_new(new, path)
    except OSError:
        if not os.path.lexists(path):
            raise
        what = "folder" if path.is_dir() else "file"
        raise _problem(path, "nothing there, as when the work began", f"a {what} of that name") from None


def _refuse_removal(path: Path, place: Path, marker: str | None, mark: str) -> None:
    """Check that what lies at a place, and is or was ``path``, is an earlier output and nothing else.

    Raises:
        InputError: it is not.
    """
    other = "Choose another name."
    if marker is None:
        if place.is_dir():
            raise _problem(path, "a file to replace", "a folder", other)
        if mark and not place.is_symlink() and not _has_mark(place, mark):
            raise _problem(path, f"a file to replace that holds {mark}", "another file", other)
        return
    if place.is_symlink():
        fix = "Give the folder itself, or another name."
        raise _problem(path, "a folder, or nothing yet", f"a link to {place.readlink()}", fix)
    if not place.is_dir():
        raise _problem(path, "a folder to replace", "a file", other)
    if any(place.iterdir()) and not (place / marker).is_file():
        raise _problem(path, f"a folder with a {marker}", "a folder of something else", other)
    found = strangers(place) if any(place.iterdir()) else []
    if found:
        more = f" and {len(found) - _SHOWN} more" if len(found) > _SHOWN else ""
        fix = "Move that elsewhere, or choose another name: --force removes only what skincal wrote."
        raise _problem(
            path, "a folder of skincal's files alone", f"also {', '.join(found[:_SHOWN])}{more}", fix
        )


def _refuse_input(path: Path, one: Path) -> None:
    out, source = path.resolve(), one.resolve()
    if not source.exists():
        return
    inside = source.is_dir() and out.is_relative_to(source) and holds(source, out)
    if out == source or out in source.parents or inside:
        fix = "Choose another name: what is read stays as it is."
        raise _problem(path, "another place than those that are read", f"that of {one}", fix)


def _refuse_unwritable(path: Path) -> None:
    """Try what :func:`whole_folder` will do: no permission tells of names that are too long, or of /proc."""
    try:
        made = _beside(path)
        with suppress(FileNotFoundError):
            made.rmdir()
    except OSError as error:
        fix = _NOT_THERE.get(error.errno or 0)
        if fix is None:  # a full disk, say: no fault of the name
            error.filename = str(path)
            raise
        reason = (error.strerror or str(error)).lower()
        expected = "an output that can be written, its temporary folder beside it"
        raise _problem(path, expected, reason, fix) from None


@contextmanager
def _at_work(path: Path, marker: str | None) -> Generator[None]:
    """Keep others from working in a folder, or from sweeping it, while it is replaced.

    Raises:
        InputError: somebody is at work in it.
    """
    with ExitStack() as held:
        for name in () if marker is None else (marker, NAME):
            if (path / name).is_file():
                held.enter_context(alone(path / name, path))
        yield


def _has_mark(path: Path, mark: str) -> bool:
    """Whether a file is empty, or has a text near its beginning or its end."""
    with open_input(path) as file:
        size = file.seek(0, os.SEEK_END)
        file.seek(0)
        ends = file.read(_ENDS)
        file.seek(max(0, size - _ENDS))
        return not size or mark.encode() in ends + b"\0" + file.read(_ENDS)


def _problem(path: Path, expected: str, got: str, fix: str = "") -> InputError:
    return InputError([Problem(str(path), expected, got, fix)])


def _beside(path: Path) -> Path:
    """A new temporary folder beside an output."""
    return Path(tempfile.mkdtemp(prefix=f".{path.name}.", suffix=".part", dir=path.parent))


def _umask() -> int:
    """The process's file mode mask; mkdtemp ignores it, an output should not."""
    mask = os.umask(0)
    os.umask(mask)
    return mask
