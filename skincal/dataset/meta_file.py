"""``dataset.toml``: reading and writing; the hash of a dataset."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any

from skincal.bounded import parse_toml, read_text
from skincal.dataset.findings import Findings
from skincal.dataset.schema import Table, load_toml, plain_table, read_table
from skincal.dataset.spec import FORMAT, DatasetMeta
from skincal.dataset.table_file import SUFFIXES, file_state
from skincal.errors import readable
from skincal.files import open_input

FILE = "dataset.toml"


def read_meta(folder: Path, findings: Findings) -> DatasetMeta | None:
    """Return the content of ``dataset.toml``; None if the file is missing or not TOML.

    A wrong value adds an error and reads as a placeholder, so that the tables can still be checked against the rest.
    """
    values = load_toml(folder / FILE, findings, what="dataset", within=folder)
    if values is None:
        return None
    if "created" not in values:
        findings.warn(f"{FILE}, created", "a date and time", "nothing")
    return read_table(DatasetMeta, values, findings, FILE, FORMAT)


def write_meta(meta: DatasetMeta, path: Path) -> None:
    """Write ``dataset.toml``, without keys whose value is None."""
    import tomli_w

    plain = {name: plain_table(v) if isinstance(v, Table) else v for name, v in plain_table(meta).items()}
    order = ("created", "source", "assumed")
    top: dict[str, Any] = {"format": FORMAT} | {name: plain[name] for name in order if name in plain}
    path.write_bytes(readable(tomli_w.dumps(top | plain)).encode())


def dataset_hash(path: str | Path) -> str:
    """Return the SHA-256 over names and contents of the files of a dataset, in hexadecimal, 64 characters.

    These are ``dataset.toml``, the tables, and the files that ``dataset.toml`` names; a README does not count.

    Raises:
        OSError: a file cannot be read.
        ValueError: ``dataset.toml`` is not a TOML file.
    """
    folder = Path(path)
    values = parse_toml(read_text(folder / FILE, within=folder))
    keys = (("surface", "file"), ("indenter", "file"), ("sensor", "positions"))
    return hash_of(folder, [values.get(table, {}).get(key) for table, key in keys])


def hash_of(folder: Path, named: Iterable[str | None]) -> str:
    """Return the :func:`dataset_hash` of a folder; ``named`` are the files that its ``dataset.toml`` names."""
    digest = hashlib.sha256()
    for name in sorted(_names(folder, named)):
        file = folder / name
        digest.update(f"{name}\0{file.stat().st_size}\0".encode())
        with open_input(file, folder) as stream:
            while block := stream.read(1 << 20):
                digest.update(block)
    return digest.hexdigest()


def file_states(folder: Path, named: Iterable[str | None]) -> dict[str, tuple[int, ...]]:
    """Return the state of each file of a dataset, which changes when it is replaced; missing files are left out."""
    found: dict[str, tuple[int, ...]] = {}
    for name in _names(folder, named):
        with suppress(OSError):
            found[name] = file_state(folder / name)
    return found


def _names(folder: Path, named: Iterable[str | None]) -> set[str]:
    """Return the names of the dataset's files that exist."""
    tables = [f"{stem}{suffix}" for stem in ("presses", "frames") for suffix in SUFFIXES]
    return {FILE} | {name for name in (*named, *tables) if name and (folder / name).is_file()}
