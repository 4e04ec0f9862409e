"""The hash of a dataset, by which a calibration identifies its data."""

from __future__ import annotations

import hashlib
from pathlib import Path

from skincal.bounded import parse_toml, read_text
from skincal.dataset.meta_file import FILE
from skincal.dataset.table_file import SUFFIXES
from skincal.files import open_input


def dataset_hash(path: str | Path) -> str:
    """Return the SHA-256 over names and contents of the files that belong to a dataset.

    These are ``dataset.toml``, the tables, and the files that ``dataset.toml`` names. Other files in the folder, such
    as a README, do not count.

    Returns:
        The hash in hexadecimal, 64 characters.

    Raises:
        OSError: a file cannot be read.
    """
    folder = Path(path)
    digest = hashlib.sha256()
    for name in sorted(_names(folder)):
        file = folder / name
        digest.update(f"{name}\0{file.stat().st_size}\0".encode())
        with open_input(file, folder) as stream:
            while block := stream.read(1 << 20):
                digest.update(block)
    return digest.hexdigest()


def _names(folder: Path) -> set[str]:
    values = parse_toml(read_text(folder / FILE, within=folder))
    named = [values.get("surface", {}).get("file"), values.get("indenter", {}).get("file")]
    named.append(values.get("sensor", {}).get("positions"))
    tables = [f"{stem}{suffix}" for stem in ("presses", "frames") for suffix in SUFFIXES]
    return {FILE} | {name for name in (*named, *tables) if name and (folder / name).is_file()}
