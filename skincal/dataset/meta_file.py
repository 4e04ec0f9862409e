"""``dataset.toml``: a strict reader, and a writer."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from datetime import date, datetime
from pathlib import Path
from typing import Any

from skincal.dataset.findings import Findings
from skincal.dataset.meta_tables import TABLES, check_format, load_toml, meta_from, plain_table, tables_of
from skincal.dataset.spec import FORMAT, DatasetMeta
from skincal.dataset.toml_table import TomlTable

FILE = "dataset.toml"

TOP_KEYS = ("format", "created", "source", "assumed", *TABLES)


def read_meta(folder: Path, findings: Findings) -> DatasetMeta | None:
    """Read ``dataset.toml``.

    A wrong value adds an error and reads as a placeholder, so that the tables can still be checked against the
    rest.

    Args:
        folder: the dataset.
        findings: collects errors and warnings.

    Returns:
        The content; None if the file is missing or not TOML.
    """
    values = load_toml(folder / FILE, findings, what="dataset", within=folder)
    return None if values is None else _meta(values, findings)


def write_meta(meta: DatasetMeta, path: Path) -> None:
    """Write ``dataset.toml``, without keys whose value is None."""
    import tomli_w

    top: dict[str, Any] = {
        "format": FORMAT,
        "created": meta.created,
        "source": meta.source,
        "assumed": list(meta.assumed),
        **{name: plain_table(getattr(meta, name)) for name in TABLES if getattr(meta, name) is not None},
        **meta.extra,
    }
    path.write_bytes(tomli_w.dumps({k: v for k, v in top.items() if v is not None}).encode())


def _meta(values: Mapping[str, Any], findings: Findings) -> DatasetMeta:
    top = TomlTable(findings, FILE, "", values, TOP_KEYS)
    check_format(top, FORMAT)
    return replace(
        meta_from(top, tables_of(top)),
        created=_created(top, findings),
        source=top.text("source", "a text", default=""),
        assumed=_assumed(top),
        extra=top.extra,
    )


def _created(top: TomlTable, findings: Findings) -> datetime | date | None:
    value = top.raw("created")
    if isinstance(value, str):
        try:
            return datetime.fromisoformat(value.strip())
        except ValueError:
            top.error("created", "a date and time like 2026-11-20T12:00:00Z", f'"{value}"')
            return None
    if value is None:
        findings.warn(top.place("created"), "a date and time", "nothing")
    elif not isinstance(value, date):
        top.error("created", "a date and time like 2026-11-20T12:00:00Z", value)
        return None
    return value


def _assumed(top: TomlTable) -> tuple[str, ...]:
    value = top.raw("assumed")
    if value is None:
        return ()
    if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
        top.error("assumed", 'a list of texts like ["force_n"]', value)
        return ()
    return tuple(value)
