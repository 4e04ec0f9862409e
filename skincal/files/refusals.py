"""Refusals of outputs: what an output may not take the place of, told before any work is done and again at the end."""

from __future__ import annotations

import errno
import os
import shlex
import tempfile
from collections.abc import Generator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from skincal.errors import InputError, Problem
from skincal.files.inputs import open_input
from skincal.files.locks import alone
from skincal.files.manifest import NAME, holds, strangers
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
        raise problem(path, "a name for the output", "no name, but a place", "Add a name to it.")
    if not path.parent.is_dir():
        file = next((above for above in path.parents if above.exists() and not above.is_dir()), None)
        got = "no such folder" if file is None else f"{file}, which is a file"
        fix = f"mkdir -p {shlex.quote(str(path.parent))}" if file is None else "Choose another name."
        raise problem(path, "an output inside an existing folder", got, fix)
    _refuse_unwritable(path)
    for one in inputs:
        _refuse_input(path, one)
    recover(path)
    if not os.path.lexists(path):
        return
    if not force and not (marker is not None and path.is_symlink()):
        what = "folder" if path.is_dir() else "file"
        fix = "Add --force to replace it."
        raise problem(path, "an output that does not exist yet", f"an existing {what}", fix)
    refuse_removal(path, path, marker, mark)
    with at_work(path, marker):
        pass


def refuse_removal(path: Path, place: Path, marker: str | None, mark: str) -> None:
    """Check that what lies at a place, and is or was ``path``, is an earlier output and nothing else.

    Raises:
        InputError: it is not.
    """
    other = "Choose another name."
    if marker is None:
        if place.is_dir():
            raise problem(path, "a file to replace", "a folder", other)
        if mark and not place.is_symlink() and not _has_mark(place, mark):
            raise problem(path, f"a file to replace that holds {mark}", "another file", other)
        return
    if place.is_symlink():
        fix = "Give the folder itself, or another name."
        raise problem(path, "a folder, or nothing yet", f"a link to {place.readlink()}", fix)
    if not place.is_dir():
        raise problem(path, "a folder to replace", "a file", other)
    if any(place.iterdir()) and not (place / marker).is_file():
        raise problem(path, f"a folder with a {marker}", "a folder of something else", other)
    found = strangers(place) if any(place.iterdir()) else []
    if found:
        more = f" and {len(found) - _SHOWN} more" if len(found) > _SHOWN else ""
        fix = "Move that elsewhere, or choose another name: --force removes only what skincal wrote."
        raise problem(
            path, "a folder of skincal's files alone", f"also {', '.join(found[:_SHOWN])}{more}", fix
        )


def _refuse_input(path: Path, one: Path) -> None:
    out, source = path.resolve(), one.resolve()
    if not source.exists():
        return
    inside = source.is_dir() and out.is_relative_to(source) and holds(source, out)
    if out == source or out in source.parents or inside:
        fix = "Choose another name: what is read stays as it is."
        raise problem(path, "another place than those that are read", f"that of {one}", fix)


def _refuse_unwritable(path: Path) -> None:
    """Try what :func:`whole_folder` will do: no permission tells of names that are too long, or of /proc."""
    try:
        made = temporary_beside(path)
        with suppress(FileNotFoundError):
            made.rmdir()
    except OSError as error:
        fix = _NOT_THERE.get(error.errno or 0)
        if fix is None:  # a full disk, say: no fault of the name
            error.filename = str(path)
            raise
        reason = (error.strerror or str(error)).lower()
        expected = "an output that can be written, its temporary folder beside it"
        raise problem(path, expected, reason, fix) from None


@contextmanager
def at_work(path: Path, marker: str | None) -> Generator[None]:
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


def problem(path: Path, expected: str, got: str, fix: str = "") -> InputError:
    """Return the error that tells of an output."""
    return InputError([Problem(str(path), expected, got, fix)])


def temporary_beside(path: Path) -> Path:
    """Return a new temporary folder beside an output."""
    return Path(tempfile.mkdtemp(prefix=f".{path.name}.", suffix=".part", dir=path.parent))
