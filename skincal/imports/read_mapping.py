"""Strict reader of mapping files: all violations at once, and suggestions for unknown keys."""

from __future__ import annotations

from collections.abc import Mapping as Map
from contextlib import suppress
from dataclasses import replace
from datetime import date, datetime
from pathlib import Path
from typing import Any

from skincal.dataset import DatasetMeta
from skincal.dataset.columns import NO_FORCE
from skincal.dataset.companions import read_meshes, read_positions
from skincal.dataset.findings import Findings, did_you_mean
from skincal.dataset.meta_tables import TABLES, check_format, load_toml, meta_from, tables_of
from skincal.imports import mapping_taxels, targets
from skincal.imports.mapping import FORMAT, BagFormat, CsvFormat, CutRules, Mapping, Quantity
from skincal.imports.mapping_columns import read_columns
from skincal.imports.mapping_tables import (
    CSV_KEYS,
    FRAME_KEYS,
    SERIES_KEYS,
    read_bag_format,
    read_csv_format,
    read_cut,
    read_placement,
)
from skincal.imports.mapping_taxels import read_taxels
from skincal.imports.strict import StrictTable

OWN = ("columns", "taxels", "frame", "series")
KEYS = {"csv": ("csv", "files"), "bag": ("bag", "topics", "joints")}


def read_mapping(path: Path, source: str) -> Mapping:
    """Read a mapping file.

    Args:
        path: the file.
        source: kind of source: ``csv`` or ``bag``.

    Raises:
        InputError: the file has violations; ``problems`` holds all of them.
    """
    findings = Findings()
    values = load_toml(path, findings, what="mapping")
    findings.raise_errors()
    assert values is not None
    mapping = _mapping(path, values, source, findings)
    findings.raise_errors()
    return mapping


def _mapping(path: Path, values: Map[str, Any], source: str, findings: Findings) -> Mapping:
    file = path.name
    other = "bag" if source == "csv" else "csv"
    known = ("format", "created", "source", "assumed", *TABLES, *OWN, *KEYS[source])
    if other in values and source not in values:
        verb = "rosbag" if other == "bag" else "csv"
        findings.error(
            f"{file}, [{other}]", f"a table [{source}]", "another", f"Use `skincal import {verb}`."
        )
        findings.raise_errors()
    top = StrictTable(findings, file, "", values, known)
    check_format(top, FORMAT)
    meta = _meta(top, findings, file)
    if not top.has(source):
        top.error(f"[{source}]", f"a table [{source}]", "nothing")
    table = top.table(source, CSV_KEYS, findings) if source == "csv" else top
    files = top.table("files", (), findings, strict=False)
    found = (
        read_bag_format(top, findings) if source == "bag"
        else read_csv_format(table, files, findings) if top.has("csv") else CsvFormat("presses")
    )  # fmt: skip
    rows = found.rows if isinstance(found, CsvFormat) else targets.SERIES
    quantities = read_columns(top.table("columns", (), findings, strict=False), source, rows, findings)
    _check_required(top, quantities, rows, meta, found)
    taxel_keys = mapping_taxels.CSV_KEYS if source == "csv" else mapping_taxels.BAG_KEYS
    # One error for the missing table is enough: its keys are not reported as missing.
    heard = findings if top.has("taxels") else Findings()
    taxels = read_taxels(top.table("taxels", taxel_keys, heard), meta.sensor, source)
    cut = _cut(top, quantities, rows, findings)
    return Mapping(
        path=path,
        meta=meta,
        quantities=quantities,
        taxels=taxels,
        placement=read_placement(top.table("frame", FRAME_KEYS, findings)),
        cut=replace(cut, own_clocks=True) if isinstance(found, CsvFormat) and found.rate_hz else cut,
        source=found,
        positions=read_positions(path.parent, file, meta.sensor, findings),
        meshes=read_meshes(path.parent, file, meta.surface, meta.indenter, findings),
    )


def _cut(top: StrictTable, quantities: tuple[Quantity, ...], rows: str, findings: Findings) -> CutRules:
    mapped = {q.target for q in quantities}
    table = top.table("series", SERIES_KEYS, findings)
    if rows == targets.PRESSES:
        if top.has("series"):
            top.error("[series]", "no such table if each row is a press", "one", "Remove it.")
        return CutRules()
    if "phase" in mapped and "press" not in mapped:
        top.error("[columns.phase]", "also a column press", "none", "Map press, or leave phase out.")
    constant = any(q.target == "force_n" and q.constant is not None for q in quantities)
    return read_cut(table, numbered="press" in mapped, constant_force=constant)


def _check_required(
    top: StrictTable,
    quantities: tuple[Quantity, ...],
    rows: str,
    meta: DatasetMeta,
    found: CsvFormat | BagFormat,
) -> None:
    mapped = {q.target for q in quantities}
    needed = targets.required_targets(rows, positions=meta.position.sigma_m != float("inf"))
    bag = isinstance(found, BagFormat)
    if not bag:
        _check_files(top, quantities, found)
    if bag and "time_s" in mapped:
        top.error("[columns.time_s]", "no time: the clock of the taxels' topic is used", "one", "Remove it.")
    for target in needed:
        if target in mapped or (bag and target == "time_s"):
            continue
        if target == "time_s" and not bag and found.rate_hz is not None:
            continue
        vector = next((name for name, parts in targets.VECTORS.items() if target in parts), target)
        known = f" (or {vector})" if vector != target else ""
        fix = f"Add [columns.{vector}]" + (", or rate_hz in [csv]." if target == "time_s" else ".")
        fix += f" {NO_FORCE}" if target == "force_n" else ""
        top.error("[columns]", f"the column {target}{known}", "nothing", fix)
    if not top.has("taxels"):
        top.error("[taxels]", "a table [taxels]", "nothing")


def _check_files(top: StrictTable, quantities: tuple[Quantity, ...], form: CsvFormat) -> None:
    """Check that files are joined by time, and that ``[files]`` describes every file named in ``[columns]``."""
    names = [joined.name for joined in form.joined]
    if names and form.rows == targets.PRESSES:
        top.error("[files]", "no other files if each row is a press", "one", 'Set rows = "series" in [csv].')
    for quantity in quantities:
        if not quantity.topic:
            continue
        if quantity.target == "time_s":
            top.error("[columns.time_s] file", "the clock of the file with the taxels", f'"{quantity.topic}"')
        elif quantity.topic not in names:
            close = did_you_mean(quantity.topic, names)
            known = f"a table of [files], which has {', '.join(names) or 'none'}"
            fix = f'Did you mean "{close}"?' if close else f"Add [files.{quantity.topic}]."
            top.error(f"[columns.{quantity.target}] file", known, f'"{quantity.topic}"', fix)
    for name in names:
        if all(quantity.topic != name for quantity in quantities):
            top.error(
                f"[files.{name}]", "a column that is taken from it", "none", f'Write file = "{name}" there.'
            )
    if form.rate_hz is not None and any(q.target == "time_s" for q in quantities):
        top.error("[columns.time_s]", "either stamps or rate_hz in [csv]", "both", "Remove one of them.")


def _meta(top: StrictTable, findings: Findings, file: str) -> DatasetMeta:
    meta = meta_from(top, tables_of(top))
    created = top.raw("created")
    if isinstance(created, str):
        with suppress(ValueError):
            created = datetime.fromisoformat(created.strip())
    if created is not None and not isinstance(created, date):
        top.error("created", "a date and time like 2026-11-20T12:00:00Z", created)
        created = None
    return replace(
        meta,
        created=created,
        source=top.text("source", "a text", default=""),
        assumed=top.texts("assumed", 'a list of texts like ["force_n"]', default=())
        if top.raw("assumed") != []
        else (),
    )
