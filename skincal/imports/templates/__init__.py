"""Commented mapping files to start from."""

from __future__ import annotations

from pathlib import Path

from skincal.dataset.findings import did_you_mean
from skincal.errors import input_error

FOLDER = Path(__file__).parent


def template_names() -> tuple[str, ...]:
    """Return the names of the bundled mapping files."""
    return tuple(sorted(path.stem for path in FOLDER.glob("*.toml")))


def template(kind: str) -> str:
    """Return a working mapping file with comments.

    Args:
        kind: ``csv`` or ``rosbag``, or the name of a public data set.

    Raises:
        InputError: there is no file of that name.
    """
    names = template_names()
    if kind not in names:
        close = did_you_mean(kind, names)
        fix = f'Did you mean "{close}"?' if close else ""
        raise input_error("template", f"one of {', '.join(names)}", f'"{kind}"', fix)
    return (FOLDER / f"{kind}.toml").read_text(encoding="utf-8")
