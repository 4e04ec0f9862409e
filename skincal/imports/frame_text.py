"""Text that is not a table: blocks of rows, one per frame, and lines of ``name=value``.

Tekscan's ASCII export and serial monitors write blocks: a line that names the frame, followed by its rows, perhaps
with a name before each. Their cells are the columns ``1``, ``2``, … row by row. The line above a block is the column
``label``, and numbers in it are columns too (``Frame 12, t = 0.24``: ``frame``, ``t``).
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skincal.dataset.findings import SHOWN, Findings
from skincal.imports.columns_of import chosen
from skincal.imports.mapping import CsvFormat
from skincal.imports.text_table import TextTable, text_lines

NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
NAMED = re.compile(rf"([A-Za-z_][\w.\[\]-]*)\s*[:=]?\s*({NUMBER})(?![\w.:])")
PAIR = re.compile(rf"([A-Za-z_][\w.\[\]-]*)\s*[:=]\s*({NUMBER})(?![\w.:])")
STAMP = re.compile(
    r"^\s*\[?(\d{1,2}:\d{2}:\d{2}(?:[.,]\d+)?|\d{4}-\d{2}-\d{2}[T ][\d:.]+)\]?\s*(?:->|[,;|])?\s*"
)
"""The time that serial monitors write before a line."""

SHAPE = re.compile(r"^\W*shape\b\W*\d+\W+\d+\W*$", re.IGNORECASE)


@dataclass
class Block:
    """Consecutive rows of numbers, with the text above and before them."""

    line: int
    label: str
    rows: list[list[float]]
    names: list[str]


def read_blocks(
    path: Path, form: CsvFormat, numbers: Collection[str], texts: Collection[str], findings: Findings
) -> TextTable | None:
    """Read blocks of rows, one per frame; None, with errors added, if their shapes differ."""
    lines = text_lines(path, form, findings, blank=True)
    if lines is None:
        return None
    blocks = _blocks(lines, form)
    if not blocks:
        findings.error(path.name, "blocks of rows of numbers", "none", "Is delimiter in [csv] the right one?")
        return None
    shapes = Counter((len(block.rows), len(block.rows[0])) for block in blocks)
    shape = shapes.most_common(1)[0][0]
    odd = [block for block in blocks if (len(block.rows), len(block.rows[0])) != shape]
    if odd:
        named = ", ".join(str(block.line) for block in odd[:SHOWN])
        got = ", ".join(f"{len(block.rows)} of {len(block.rows[0])}" for block in odd[:SHOWN])
        fix = "Was the file cut short, or are there lines to skip (skip_rows, comment)? Blocks without a line between "
        fix += "them need block_rows."
        findings.error(
            f"{path.name}, line {named}", f"a block of {shape[0]} rows of {shape[1]} cells as most", got, fix
        )
        return None
    cells = np.array([block.rows for block in blocks], dtype=np.float64).reshape(len(blocks), -1)
    columns: dict[str, NDArray[Any]] = {str(i + 1): cells[:, i] for i in range(cells.shape[1])}
    columns["label"] = np.array([block.label for block in blocks], dtype=object)
    named_values = [
        {name.lower(): float(value) for name, value in NAMED.findall(block.label)} for block in blocks
    ]
    for name in dict.fromkeys(key for values in named_values for key in values):
        columns.setdefault(name, np.array([values.get(name, np.nan) for values in named_values]))
    at = np.array([block.line for block in blocks])
    hint = f"The frames are of {shape[0]} rows of {shape[1]} cells."
    return chosen(path.name, columns, numbers, texts, form.decimal, findings, at, hint)


def read_labelled(
    path: Path, form: CsvFormat, numbers: Collection[str], texts: Collection[str], findings: Findings
) -> TextTable | None:
    """Read lines of ``name=value`` or ``name:value``; a time before them is the column ``time``."""
    lines = text_lines(path, form, findings)
    if lines is None:
        return None
    rows: list[dict[str, Any]] = []
    at: list[int] = []
    for number, line in lines:
        stamp = STAMP.match(line)
        pairs = PAIR.findall(line[stamp.end() :] if stamp else line)
        if pairs:
            rows.append({"time": stamp[1] if stamp else "", **dict(pairs)})
            at.append(number)
    if not rows:
        findings.error(path.name, "lines of name=value", "none", 'Is layout = "labelled" in [csv] right?')
        return None
    names = dict.fromkeys(name for row in rows for name in row)
    columns = {name: np.array([row.get(name, "") for row in rows], dtype=object) for name in names}
    return chosen(path.name, columns, numbers, texts, form.decimal, findings, np.array(at))


def layout_hint(path: Path, form: CsvFormat) -> str:
    """Return the layout to set for a file that was read as a table but is none; '' if unknown."""
    lines = text_lines(path, CsvFormat("series", delimiter=form.delimiter, encoding=form.encoding), Findings(),
                       blank=True)  # fmt: skip
    filled = [(number, line) for number, line in lines or [] if line.strip()][:4000]
    if not filled:
        return ""
    if SHAPE.match(filled[0][1]) and (form.header or form.skip_rows < filled[0][0]):
        return (
            f'Line {filled[0][0]} gives the shape of flat frames ("{filled[0][1].strip()}"): set '
            f"skip_rows = {filled[0][0]} and header = false in [csv]; without stamps, rate_hz too."
        )
    paired = sum(len(PAIR.findall(line)) >= 2 for _, line in filled)
    if paired > 0.8 * len(filled):
        return 'Its lines are pairs of name and value: set layout = "labelled" in [csv].'
    blocks = _blocks([item for item in lines or [] if item[0] <= filled[-1][0]], form)
    sizes = Counter((len(block.rows), len(block.rows[0])) for block in blocks)
    if sizes:
        (rows, cells), count = sizes.most_common(1)[0]
        if count >= 3 and rows > 1 and count > 0.8 * len(blocks):
            return (
                f"It holds blocks of {rows} rows of {cells} cells, one per frame, from line {blocks[0].line} on: set "
                f'layout = "blocks" in [csv]; taxels are then the columns "1" to "{rows * cells}". Without stamps, '
                "rate_hz gives the frames per second."
            )
    return ""


def _blocks(lines: list[tuple[int, str]], form: CsvFormat) -> list[Block]:
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
        ):
            blocks.append(Block(number, label, [], []))
            label, open_ = "" if open_ else label, True
        blocks[-1].rows.append(cells)
        blocks[-1].names.append(name)
    return blocks


def _row(line: str, form: CsvFormat) -> tuple[str, list[float]] | None:
    """Return the name before a row, or '', and its cells; None if a line is not a row of numbers."""
    text = line.strip()
    mark = form.delimiter
    cells = text.split() if mark == "whitespace" or mark not in text else text.split(mark)
    cells = [cell.strip() for cell in cells]
    while cells and cells[-1] == "":
        cells.pop()
    name = ""
    if cells and not re.fullmatch(NUMBER, cells[0].replace(form.decimal, ".")):
        head = re.fullmatch(rf"([A-Za-z][\w-]*)\s*:?(?:\s*({NUMBER}))?", cells[0])
        if head is None or (len(cells) < 2 and head[2] is None):
            return None
        name = head[1]
        cells = ([head[2]] if head[2] is not None else []) + cells[1:]
    # A name with one number, "Frame 12", stands above a block.
    if len(cells) < (2 if name else 1):
        return None
    try:
        return name, [float(cell.replace(form.decimal, ".")) for cell in cells]
    except ValueError:
        return None
