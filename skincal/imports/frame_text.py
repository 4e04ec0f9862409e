"""Text that is not a table: blocks of rows, one per frame, and lines of ``name=value``.

Tekscan's ASCII export and serial monitors write blocks: a line that names the frame, followed by its rows, perhaps
with a name before each, or in brackets. Their cells are the columns ``1``, ``2``, … row by row. The line above a block
is the column ``label``. Numbers in it are columns as well, by their names (``Frame 12, t = 0.24``: ``frame``, ``t``)
and by their order (``label[0]``, ``label[1]``), and a time of day or date in it is the column ``moment``.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skincal.dataset.findings import SHOWN, Findings
from skincal.imports.array_files import table_of
from skincal.imports.mapping_file import CsvFormat
from skincal.imports.text_table import TextTable, text_lines

# No part goes back over what another may have, and names have an end: a long line takes time as it is long, no more.
NUMBER = r"[-+]?(?:\d++\.?\d*+|\.\d++)(?:[eE][-+]?\d++)?"
_NAME = r"(?<![\w.\[\]-])([A-Za-z_][\w.\[\]-]{0,99})"
NAMED = re.compile(rf"{_NAME}\s*+[:=,]?\s*+({NUMBER})(?![\w.:])")
PAIR = re.compile(rf"{_NAME}\s*+[:=]\s*+({NUMBER})(?![\w.:])")
STAMP = re.compile(
    r"^\s*(?:\[\s*(\d++(?:\.\d++)?)\s*\]|\[?(\d{1,2}:\d{2}:\d{2}(?:[.,]\d+)?|\d{4}-\d{2}-\d{2}[T ][\d:.]+)\]?)"
    r"\s*(?:->|[,;|])?\s*"
)
"""The time that serial monitors write before a line: a time of day, a date with a time, or a number in brackets."""

MOMENT = re.compile(r"\d{4}-\d{2}-\d{2}[T ]\d{1,2}:\d{2}:\d{2}(?:[.,]\d+)?|\d{1,2}:\d{2}:\d{2}(?:[.,]\d+)?")
"""A date with a time, or a time of day, in the line above a block."""


@dataclass
class Block:
    """Consecutive rows of numbers, with the text above and before them."""

    line: int
    label: str
    rows: list[list[float]]
    names: list[str]

    @property
    def shape(self) -> tuple[int, int]:
        """Number of rows, and of cells in a row."""
        return len(self.rows), len(self.rows[0])


def read_blocks(
    path: Path, form: CsvFormat, numbers: Collection[str], texts: Collection[str], findings: Findings
) -> TextTable | None:
    """Read blocks of rows, one per frame; None, with errors added, if their shapes differ."""
    lines = text_lines(path, form, findings, blank=True)
    if lines is None:
        return None
    blocks = blocks_of(lines, form)
    if not blocks:
        findings.error(path.name, "blocks of rows of numbers", "none", "Is delimiter in [csv] the right one?")
        return None
    shape = Counter(block.shape for block in blocks).most_common(1)[0][0]
    if odd := [block for block in blocks if block.shape != shape]:
        findings.error(
            f"{path.name}, line {', '.join(str(block.line) for block in odd[:SHOWN])}",
            f"a block of {shape[0]} rows of {shape[1]} cells as most",
            ", ".join("{} of {}".format(*block.shape) for block in odd[:SHOWN]),
            "Was the file cut short, or are there lines to skip (skip_rows, comment)? Blocks without a line between "
            "them need block_rows, and words for cells without a value (Tekscan's B) need missing.",
        )  # fmt: skip
        return None
    cells = np.array([block.rows for block in blocks], dtype=np.float64).reshape(len(blocks), -1)
    columns: dict[str, NDArray[Any]] = {str(i + 1): cells[:, i] for i in range(cells.shape[1])}
    labels = [block.label for block in blocks]
    columns["label"] = np.array(labels, dtype=object)
    named_values = [{name.lower(): float(value) for name, value in NAMED.findall(text)} for text in labels]
    for name in dict.fromkeys(key for values in named_values for key in values):
        columns.setdefault(name, np.array([values.get(name, np.nan) for values in named_values]))
    moments = [MOMENT.search(text) for text in labels]
    if any(moments):
        columns["moment"] = np.array([found[0] if found else "" for found in moments], dtype=object)
    plain = [re.findall(rf"(?<![\w.]){NUMBER}", text) for text in labels]
    counted = np.array([*zip_longest(*plain, fillvalue="nan")], dtype=np.float64)
    columns |= {f"label[{i}]": column for i, column in enumerate(counted)}
    at = np.array([block.line for block in blocks])
    hint = f"The frames are of {shape[0]} rows of {shape[1]} cells."
    return table_of(path.name, columns, numbers, texts, form, findings, at, hint)


def read_labelled(
    path: Path, form: CsvFormat, numbers: Collection[str], texts: Collection[str], findings: Findings
) -> TextTable | None:
    """Read lines of ``name=value`` or ``name:value``; a time before them is the column ``time``."""
    lines = text_lines(path, form, findings)
    if lines is None:
        return None
    rows: dict[int, dict[str, Any]] = {}
    for number, line in lines:
        stamp = STAMP.match(line)
        if pairs := PAIR.findall(line[stamp.end() :] if stamp else line):
            rows[number] = {"time": stamp[stamp.lastindex or 0] if stamp else "", **dict(pairs)}
    if not rows:
        findings.error(path.name, "lines of name=value", "none", 'Is layout = "labelled" in [csv] right?')
        return None
    names = dict.fromkeys(name for row in rows.values() for name in row)
    columns = {name: np.array([row.get(name, "") for row in rows.values()], dtype=object) for name in names}
    return table_of(path.name, columns, numbers, texts, form, findings, np.array([*rows]))


def blocks_of(lines: list[tuple[int, str]], form: CsvFormat) -> list[Block]:
    """Return the stretches of rows of numbers of one width; a repeated name before a row starts a new stretch."""
    blocks: list[Block] = []
    label, open_ = "", False
    for number, line in lines:
        row = _row(line, form)
        if row is None:
            label, open_ = line.strip() or ("" if open_ else label), False
            continue
        name, cells = row
        last = blocks[-1] if blocks and open_ else None
        if (
            last is None
            or len(cells) != len(last.rows[0])
            or (form.block_rows and len(last.rows) == form.block_rows)
            or (name and name == last.names[0])
            or line.lstrip().startswith("[[")
        ):
            blocks.append(Block(number, label, [], []))
            label, open_ = "" if open_ else label, True
        blocks[-1].rows.append(cells)
        blocks[-1].names.append(name)
    return _labelled_by_number(blocks)


def _labelled_by_number(blocks: list[Block]) -> list[Block]:
    """Return the blocks, with every other one of a single number as the label of the next."""
    single = [block.shape == (1, 1) for block in blocks]
    pairs = len(blocks) // 2
    if not pairs or len(blocks) % 2 or not all(single[::2]) or any(single[1::2]):
        return blocks
    return [
        Block(block.line, f"{above.label} {above.rows[0][0]!r}".strip(), block.rows, block.names)
        for above, block in zip(blocks[::2], blocks[1::2], strict=True)
    ]


def _row(line: str, form: CsvFormat) -> tuple[str, list[float]] | None:
    """Return the name before a row, or '', and its cells; None if a line is not a row of numbers."""
    text = line.strip().strip("[]").strip()
    mark = form.delimiter
    cells = text.split() if mark == "whitespace" or mark not in text else text.split(mark)
    cells = [cell.strip() for cell in cells]
    while cells and cells[-1] == "":
        cells.pop()
    name = ""
    if cells and not _is_cell(cells[0], form):
        head = re.fullmatch(rf"([A-Za-z][\w-]*)\s*:?(?:\s*({NUMBER}))?", cells[0])
        if head is None or (len(cells) < 2 and head[2] is None):
            return None
        name, cells = head[1], [cell for cell in (head[2], *cells[1:]) if cell is not None]
    # A name with one number, "Frame 12", stands above a block.
    if len(cells) < (2 if name else 1) or not all(_is_cell(cell, form) for cell in cells):
        return None
    return name, [np.nan if cell in form.blanks else float(cell.replace(form.decimal, ".")) for cell in cells]


def _is_cell(cell: str, form: CsvFormat) -> bool:
    return cell in form.blanks or bool(re.fullmatch(NUMBER, cell.replace(form.decimal, ".")))
