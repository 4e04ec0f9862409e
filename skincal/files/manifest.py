"""The manifest: a list of the files that skincal wrote into a folder; without one, the file names of older versions."""

from __future__ import annotations

import json
import os
import re
import tomllib
from collections.abc import Iterable, Sequence
from fnmatch import fnmatchcase
from pathlib import Path, PurePosixPath
from typing import Any, Final, cast

from skincal.files.inputs import open_input

NAME: Final = ".skincal.json"
FORMAT: Final = "skincal-output/1"
TEMPORARY: Final = r"\.{name}\.[a-z0-9_]{{8}}\.(part|old)"
"""Patterns of the names that killed processes leave next to an output."""
_LEFTOVER: Final = re.compile(TEMPORARY.format(name=".+"))

_OLD_PICTURES = (
    "valley", "draws", "images", "slack", "residuals", "scatter", "gap", "signature", "where", "candidates", "audit",
    "scales", "answers",
)  # fmt: skip
_BEFORE: Final[dict[str, tuple[str, ...]]] = {
    "calibration.toml": (
        "calibration.toml", "grid.parquet", "slack.csv", "draws.parquet", "report.html", "diagnosis.json",
        "next-presses.toml", *(f"{stem}.png" for stem in _OLD_PICTURES),
    ),
    "dataset.toml": ("dataset.toml", "presses.csv", "presses.parquet", "frames.csv", "frames.parquet"),
    "run.toml": (
        "run.toml", "ranges.toml", "curve.csv", "curve.png", "policy.onnx", "checkpoint/state.json",
        "checkpoint/arrays.npz", "checkpoint/weights.*",
    ),
    "state.json": ("state.json", "arrays.npz", "weights.*"),
    "eval.json": ("eval.json", "runs.csv", "runs.png", "error.png"),
    "audit.png": ("audit.png",),
    "hand/hand.key_secret": (
        "README.txt", "hand/hand.key_secret", "hand/allowed/client.key", "client/client.key_secret",
        "client/hand.key",
    ),
}  # fmt: skip
"""Names of the files in folders without a list, by the file that identifies the folder."""

_NAMING: Final = (("sensor", "positions"), ("surface", "file"), ("indenter", "file"))
"""Keys of a description that name files next to it."""

_MOST: Final = 1 << 20
"""Largest number of bytes of a list or a description that are read."""

_ANY_ENDING: Final = re.compile(r"[^*?\[\]]+\.\*")
"""The only pattern in a list; a list that came with a dataset may hold others, which would match anybody's files."""

_ANYWHERE = (NAME, ".DS_Store", ".nfs*")
"""The list itself, and files that a file manager or a file server adds to any folder."""


def write_manifest(folder: Path, later: Iterable[str] = ()) -> None:
    """Write the list of all files in a finished output, and of those that ``later`` go into it, into its folder.

    The list of a folder inside of it stands for the files that this folder lists.
    """
    files = [path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()]
    content = {"tool": "skincal", "format": FORMAT, "files": sorted({*files, *later} - {NAME})}
    (folder / NAME).write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def strangers(folder: Path) -> list[str]:
    """Return the files in an output folder that skincal did not write, as names relative to it."""
    known = _known(folder)
    folders = {str(parent) for name in known for parent in PurePosixPath(name).parents}
    found: list[str] = []
    for root, inner, files in os.walk(folder):
        here = PurePosixPath(Path(root).relative_to(folder).as_posix())
        for name in (here / name for name in (*files, *inner)):
            is_folder = name.name in inner and not (folder / name).is_symlink()
            expected = str(name) in folders if is_folder else _is_known(name, known)
            if not expected and not _LEFTOVER.fullmatch(name.name):
                found.append(f"{name}/" if is_folder else str(name))
        inner[:] = [name for name in inner if str(here / name) in folders]
    return sorted(found)


def holds(folder: Path, path: Path) -> bool:
    """Return whether a file belongs to an input folder."""
    return _is_known(PurePosixPath(path.relative_to(folder).as_posix()), _known(folder))


def _known(folder: Path) -> list[str]:
    """Return the files of a folder: those of its list, and of the lists inside of it that it names."""
    known = _listed(folder)
    inner = [PurePosixPath(name).parent for name in known if PurePosixPath(name).name == NAME]
    known += [str(at / name) for at in inner for name in _listed(folder / at)]
    return known or _named_before(folder)


def _is_known(name: PurePosixPath, known: Sequence[str]) -> bool:
    patterns = [one for one in known if _ANY_ENDING.fullmatch(one)]
    whole = str(name) in known or any(fnmatchcase(str(name), one) for one in patterns)
    return whole or any(fnmatchcase(name.name, one) for one in _ANYWHERE)


def _listed(folder: Path) -> list[str]:
    try:
        content: Any = json.loads(_text(folder / NAME))
        if content["tool"] == "skincal" and isinstance(content["files"], list):
            return [name for name in cast("list[object]", content["files"]) if isinstance(name, str)]
    except (ValueError, KeyError, TypeError, RecursionError):
        pass
    return []


def _named_before(folder: Path) -> list[str]:
    """Return the expected names in a folder without a list: those of its kind, and those in its description."""
    found: list[str] = []
    for marker, names in _BEFORE.items():
        if not (folder / marker).is_file():
            continue
        found += names
        if marker in ("calibration.toml", "dataset.toml"):
            found += _described(folder / marker)
        if marker == "eval.json":
            text = _text(folder / marker)
            found += [path.name for path in folder.glob("*.gif") if path.stem in text]
    return found


def _described(file: Path) -> list[str]:
    try:
        values: Any = tomllib.loads(_text(file))
        named = [values[table].get(key) for table, key in _NAMING if isinstance(values.get(table), dict)]
        return [name for name in named if isinstance(name, str)]
    except (ValueError, RecursionError):
        return []


def _text(file: Path) -> str:
    try:
        with open_input(file, file.parent) as stream:
            return stream.read(_MOST).decode()
    except (OSError, ValueError):
        return ""
