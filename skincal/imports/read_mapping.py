"""Reading of mapping files: all violations at once, and suggestions for unknown keys."""

from __future__ import annotations

from collections.abc import Mapping as Map
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

from skincal.dataset.columns import NO_FORCE
from skincal.dataset.findings import Findings, meant
from skincal.dataset.meta_file import read_meshes, read_positions
from skincal.dataset.schema import load_toml, read_table
from skincal.dataset.schema_errors import Translator
from skincal.imports import targets
from skincal.imports.mapping import JoinedFile, Mapping, Quantity
from skincal.imports.mapping_columns import read_columns, read_quantities, read_taxels, si_name
from skincal.imports.mapping_file import FORMAT, BagMapping, CsvMapping, CutRules, JoinedFormat

AnyMapping = CsvMapping | BagMapping


def read_mapping(path: Path, source: str) -> Mapping:
    """Read a mapping file of a kind of source, ``csv`` or ``bag``.

    Raises:
        InputError: the file has violations; ``problems`` holds all of them.
    """
    findings = Findings()
    values = load_toml(path, findings, what="mapping")
    other, verb = ("bag", "rosbag") if source == "csv" else ("csv", "csv")
    if values is not None and other in values and source not in values:
        fix = f"Use `skincal import {verb}`."
        findings.error(f"{path.name}, [{other}]", f"a table [{source}]", "another", fix)
    findings.raise_errors()
    assert values is not None
    mapping = _mapping(path, values, source, findings)
    findings.raise_errors()
    return mapping


def _mapping(path: Path, values: Map[str, Any], source: str, findings: Findings) -> Mapping:
    name, given = path.name, values
    if source == "csv":
        given = {**values, "columns": _in_full(values.get("columns", {}))}
    file = read_table(CsvMapping if source == "csv" else BagMapping, given, findings, name, FORMAT)
    report = Translator(findings, name)
    rows = targets.SERIES if isinstance(file, BagMapping) else file.csv.rows
    quantities = read_columns(file.columns, rows, name, report) if rows else ()
    joined, cut = _joined(file, report, name), CutRules()
    if rows:
        cut = _cut(file, values.get("series"), quantities, rows, report)
        _check_required(file, quantities, joined, rows, report)
    # One error for the missing table is enough: its keys are not reported as missing.
    of_taxels = report if "taxels" in values else Translator(Findings(), name)
    timed = isinstance(file, CsvMapping) and file.csv.rate_hz
    return Mapping(
        path=path,
        file=file,
        meta=file.meta(created=file.created, source=file.source, assumed=file.assumed),
        quantities=quantities,
        taxels=read_taxels(file.taxels, file.sensor, name, of_taxels, moments=rows == targets.SERIES),
        cut=replace(cut, own_clocks=True) if timed else cut,
        joined=joined,
        positions=read_positions(path.parent, name, file.sensor, findings),
        meshes=read_meshes(path.parent, name, file.surface, file.indenter, findings),
    )


def _in_full(columns: Any) -> Any:
    """Return ``[columns]`` with entries in SI, which may be names alone, written as tables."""
    if not isinstance(columns, dict):
        return columns
    return {
        target: {"column": entry, "unit": si_name(target)} if isinstance(entry, str) else entry
        for target, entry in cast("dict[str, Any]", columns).items()
    }


def _joined(file: AnyMapping, report: Translator, name: str) -> tuple[JoinedFile, ...]:
    files: Map[str, JoinedFormat] = file.files if isinstance(file, CsvMapping) else {}
    times = {
        table: read_quantities(form.time, "time_s", ("files", table, "time"), name, report)[0]
        for table, form in files.items()
        if form.time is not None
    }
    _check_clocks(files, report)
    # Files with the clock of another come after it.
    return tuple(
        JoinedFile(table, f"{name}, [files.{table}]", form, times.get(table))
        for table, form in sorted(files.items(), key=lambda item: bool(item[1].clock))
    )


def _check_clocks(files: Map[str, JoinedFormat], report: Translator) -> None:
    for table, form in files.items():
        own = [other for other, one in files.items() if other != table and not one.clock]
        if form.clock and form.clock not in own:
            known = ", ".join(own) or "there is none"
            expected = f"another table of [files] with a clock of its own ({known})"
            fix = meant(form.clock, own, "Leave it out for a clock of its own.")
            report.violation(("files", table, "clock"), expected, f'"{form.clock}"', fix)


def _cut(
    file: AnyMapping, given: Any, quantities: tuple[Quantity, ...], rows: str, report: Translator
) -> CutRules:
    """Return ``[series]``, of which some keys are given.

    A press is a number in a column where there is one, else a contact.
    """
    if rows == targets.PRESSES:
        if file.series is not None:
            report.violation(("[series]",), "no such table if each row is a press", "one", "Remove it.")
        return CutRules()
    mapped = {q.target: q for q in quantities}
    numbered = "press" in mapped
    constant = "force_n" in mapped and mapped["force_n"].constant is not None
    if "phase" in mapped and not numbered:
        fix = "Map press, or leave phase out."
        report.violation(("[columns.phase]",), "also a column press", "none", fix)
    cut = file.series or CutRules()
    keys = cast("dict[str, Any]", given) if isinstance(given, dict) else {}
    off_n = cut.off_n if "off_n" in keys else cut.on_n / 2
    by = cut.by if "by" in keys else "press" if numbered else "taxels" if constant else "force"
    if numbered and by != "press":
        expected = '"press" where [columns.press] is mapped'
        report.violation(("series", "by"), expected, f'"{by}"', "Remove one of them.")
    if by == "press" and not numbered:
        report.violation(("series", "by"), "a column press in [columns]", "none")
    if off_n > cut.on_n:
        report.violation(("series", "off_n"), f"at most on_n = {cut.on_n:g}", off_n)
    return replace(cut, by=by, off_n=off_n)


def _check_required(
    file: AnyMapping, quantities: tuple[Quantity, ...], joined: tuple[JoinedFile, ...], rows: str, report: Translator
) -> None:  # fmt: skip
    mapped = {q.target for q in quantities}
    timed = isinstance(file, BagMapping) or file.csv.rate_hz is not None
    place = ("[columns.time_s]",)
    if "time_s" in mapped and isinstance(file, BagMapping):
        report.violation(place, "no time: the clock of the taxels' topic is used", "one", "Remove it.")
    elif "time_s" in mapped and timed:
        report.violation(place, "either stamps or rate_hz in [csv]", "both", "Remove one of them.")
    if isinstance(file, CsvMapping):
        _check_files(quantities, joined, rows, report)
    for target in targets.required_targets(rows, positions=file.position.sigma_m != float("inf")):
        if target in mapped or (timed and target == "time_s"):
            continue
        vector = next((name for name, parts in targets.VECTORS.items() if target in parts), target)
        known = f" (or {vector})" if vector != target else ""
        fix = f"Add [columns.{vector}]" + (", or rate_hz in [csv]." if target == "time_s" else ".")
        fix += f" {NO_FORCE}" if target == "force_n" else ""
        report.violation(("[columns]",), f"the column {target}{known}", "nothing", fix)


def _check_files(
    quantities: tuple[Quantity, ...], joined: tuple[JoinedFile, ...], rows: str, report: Translator
) -> None:
    """Check that files are joined by time, and that ``[files]`` describes every file named in ``[columns]``."""
    names = [one.name for one in joined]
    if names and rows == targets.PRESSES:
        fix = 'Set rows = "series" in [csv].'
        report.violation(("[files]",), "no other files if each row is a press", "one", fix)
    for quantity in quantities:
        place, got = ("columns", quantity.target, "file"), f'"{quantity.topic}"'
        if quantity.topic and quantity.target == "time_s":
            report.violation(place, "the clock of the file with the taxels", got)
        elif quantity.topic and quantity.topic not in names:
            known = f"a table of [files], which has {', '.join(names) or 'none'}"
            fix = meant(quantity.topic, names, f"Add [files.{quantity.topic}].")
            report.violation(place, known, got, fix)
    numbered = any(quantity.target == "press" and not quantity.topic for quantity in quantities)
    for one in joined:
        if one.form.press and not numbered:
            fix = "Map press from the file of the taxels."
            report.violation(("files", one.name, "press"), "also [columns.press]", "none", fix)
    for name in names:
        if all(quantity.topic != name for quantity in quantities):
            fix = f'Write file = "{name}" there.'
            report.violation((f"[files.{name}]",), "a column that is taken from it", "none", fix)
