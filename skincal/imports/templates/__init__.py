"""Commented mapping files to start from."""

from __future__ import annotations

from pathlib import Path

from skincal.dataset.findings import meant
from skincal.errors import input_error

FOLDER = Path(__file__).parent


def template(kind: str) -> str:
    """Return a working mapping file with comments: ``csv``, ``rosbag``, or that of a public data set.

    Raises:
        InputError: there is no file of that name.
    """
    names = sorted(path.stem for path in FOLDER.glob("*.toml"))
    if kind not in names:
        raise input_error("template", f"one of {', '.join(names)}", f'"{kind}"', meant(kind, names))
    return (FOLDER / f"{kind}.toml").read_text(encoding="utf-8")
