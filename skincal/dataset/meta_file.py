"""``dataset.toml``: reading and writing."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from skincal.dataset.findings import Findings
from skincal.dataset.schema import Table, load_toml, plain_table, read_table
from skincal.dataset.spec import FORMAT, DatasetMeta

FILE = "dataset.toml"


def read_meta(folder: Path, findings: Findings) -> DatasetMeta | None:
    """Read ``dataset.toml``.

    A wrong value adds an error and reads as a placeholder, so that the tables can still be checked against the
    rest.

    Returns:
        The content; None if the file is missing or not TOML.
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
    path.write_bytes(tomli_w.dumps(top | plain).encode())
