"""Missing columns that another of the given files holds: two devices, each with its own clock."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from skincal.dataset.findings import Findings
from skincal.imports.mapping import Mapping
from skincal.imports.mapping_file import CsvFormat
from skincal.imports.text_table import column_names


def explain_missing(paths: Sequence[Path], form: CsvFormat, mapping: Mapping, findings: Findings) -> None:
    """Replace the errors of missing columns by one error if another file holds them."""
    held = {path: column_names(path, form) for path in paths}
    taxels = next((path for path in paths if set(mapping.taxels.names) <= set(held[path])), None)
    if taxels is None:
        return
    elsewhere: dict[Path, list[str]] = {}
    for quantity in mapping.quantities:
        if quantity.sources and not set(quantity.sources) <= set(held[taxels]):
            other = next((path for path in paths if set(quantity.sources) <= set(held[path])), None)
            if other is None:
                return
            elsewhere.setdefault(other, []).append(quantity.target)
    if not elsewhere:
        return
    findings.errors.clear()
    for path, targets in elsewhere.items():
        name = "".join(letter if letter.isalnum() else "_" for letter in path.stem)
        free = ", ".join(f'"{column}"' for column in held[path][:6])
        findings.error(
            path.name, f"the columns of {taxels.name}: files of one list follow each other in time",
            f"those of another device, with {', '.join(targets)} (columns {free})",
            f'Describe it as a file with its own clock: [files.{name}] with file = "{path.name}" and '
            f'time = {{ column = "...", unit = "..." }}, and write file = "{name}" in '
            f"{', '.join(f'[columns.{target}]' for target in targets)}.",
        )  # fmt: skip
