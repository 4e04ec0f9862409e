"""Refusals of outputs: what an output must not replace, checked before any work and again at the end."""

from __future__ import annotations

import errno
import os
import shlex
import tempfile
from collections.abc import Generator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from skincal.errors import first_of, input_error
from skincal.files.inputs import open_input, real, reason
from skincal.files.locks import alone, recover
from skincal.files.manifest import NAME, holds, strangers
from skincal.signals import held_back

_NOT_THERE = {errno.ENAMETOOLONG: "Choose a shorter name."} | dict.fromkeys(
    (errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOENT),
    "Choose another place, or make the folder writable.",
)
"""Advice where no file of such a name can be written; /proc answers ENOENT."""

_ENDS = 4096
"""Number of bytes at both ends of a file that are searched for its mark."""


def refuse_existing(
    path: Path, *inputs: str | Path | None, force: bool, marker: str | None = None, mark: str = ""
) -> None:
    """Check, before any work, that an output may be written; remove leftovers of a killed run.

    Args:
        path: the output file or folder.
        inputs: input files and folders, which the output must not replace; None is skipped.
        force: whether an existing output may be replaced.
        marker: for a folder, the file that identifies an earlier output. ``force`` replaces only a folder that holds
            it (or is empty) and nothing that skincal did not write: a mistyped path deletes nobody's work.
        mark: for a file, text that identifies an earlier output; ``force`` replaces no other file.

    Raises:
        InputError: it exists and may not be replaced, its parent folder does not exist or may not be written to, or it
            has no name.
    """
    if path.name in ("", ".."):
        raise input_error(str(path), "a name for the output", "no name, but a place", "Add a name to it.")
    if not path.parent.is_dir():
        file = next((above for above in path.parents if above.exists() and not above.is_dir()), None)
        got = "no such folder" if file is None else f"{file}, which is a file"
        fix = f"mkdir -p {shlex.quote(str(path.parent))}" if file is None else "Choose another name."
        raise input_error(str(path), "an output inside an existing folder", got, fix)
    _refuse_unwritable(path)
    for one in inputs:
        if one is not None:
            _refuse_input(path, Path(one))
    recover(path)
    if not os.path.lexists(path):
        return
    if not force and not (marker is not None and path.is_symlink()):
        what = "folder" if path.is_dir() else "file"
        fix = "Add --force to replace it."
        raise input_error(str(path), "an output that does not exist yet", f"an existing {what}", fix)
    refuse_removal(path, path, marker, mark)
    with at_work(path, marker):
        pass


def refuse_removal(path: Path, place: Path, marker: str | None, mark: str) -> None:
    """Raise an InputError unless ``place``, which is or was ``path``, holds an earlier output and nothing else."""
    other = "Choose another name."
    if marker is None:
        if place.is_dir():
            raise input_error(str(path), "a file to replace", "a folder", other)
        if mark and not place.is_symlink() and not _has_mark(place, mark):
            raise input_error(str(path), f"a file to replace that holds {mark}", "another file", other)
        return
    if place.is_symlink():
        fix = "Give the folder itself, or another name."
        raise input_error(str(path), "a folder, or nothing yet", f"a link to {place.readlink()}", fix)
    if not place.is_dir():
        raise input_error(str(path), "a folder to replace", "a file", other)
    if any(place.iterdir()) and not (place / marker).is_file():
        raise input_error(str(path), f"a folder with a {marker}", "a folder of something else", other)
    if any(place.iterdir()) and (found := strangers(place)):
        fix = "Move that elsewhere, or choose another name: --force removes only what skincal wrote."
        raise input_error(str(path), "a folder with files of skincal only", f"also {first_of(found)}", fix)


def _refuse_input(path: Path, one: Path) -> None:
    out, source = real(path), real(one)
    if not source.exists():
        return
    same = source.is_dir() and out.is_relative_to(source) and holds(source, out)
    for place in (source, *source.parents):
        with suppress(OSError):  # by a mount, a hard link or letters of another case, too
            same |= out == place or out.samefile(place)
    if same:
        fix = "Choose another name: inputs are not replaced."
        raise input_error(str(path), "an output that is not an input", f"that of {one}", fix)


def _refuse_unwritable(path: Path) -> None:
    """Try what :func:`whole_folder` will do: permissions do not reveal names that are too long, or /proc."""
    try:
        with held_back(), suppress(FileNotFoundError):
            make_temporary_folder(path).rmdir()
    except OSError as error:
        fix = _NOT_THERE.get(error.errno or 0)
        if fix is None:  # a full disk, for instance: not a fault of the name
            error.filename = str(path)
            raise
        expected = "a writable place for the output and its temporary folder"
        raise input_error(str(path), expected, reason(error), fix) from None


@contextmanager
def at_work(path: Path, marker: str | None) -> Generator[None]:
    """Keep others from working in a folder, or from cleaning it up, while it is replaced.

    Raises:
        InputError: another process is at work in it.
    """
    with ExitStack() as held:
        for name in () if marker is None else (marker, NAME):
            if (path / name).is_file():
                held.enter_context(alone(path / name, path))
        yield


def _has_mark(path: Path, mark: str) -> bool:
    with open_input(path) as file:
        size = file.seek(0, os.SEEK_END)
        file.seek(0)
        ends = file.read(_ENDS)
        file.seek(max(0, size - _ENDS))
        return not size or mark.encode() in ends + b"\0" + file.read(_ENDS)


def make_temporary_folder(path: Path) -> Path:
    """Return a new temporary folder next to an output."""
    return Path(tempfile.mkdtemp(prefix=f".{path.name}.", suffix=".part", dir=path.parent))
