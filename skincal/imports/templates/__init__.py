"""Commented mapping files to begin with."""

from __future__ import annotations

from pathlib import Path


def template(kind: str) -> str:
    """A mapping file that works, with comments; ``kind`` is ``csv`` or ``rosbag``."""
    return (Path(__file__).parent / f"{kind}.toml").read_text(encoding="utf-8")
