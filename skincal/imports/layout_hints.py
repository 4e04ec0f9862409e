"""Advice for text files that cannot be read with the given layout: the lines of ``[csv]`` that read them."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from itertools import accumulate, chain, combinations
from pathlib import Path
from typing import Final

from skincal.bounded import UnreadableError, parse_csv
from skincal.dataset.findings import Findings
from skincal.imports.frame_text import NUMBER, PAIR, blocks_of
from skincal.imports.mapping_file import CsvFormat
from skincal.imports.text_table import TextTable, text_lines

MOST_LINES: Final = 4000

MOST_LETTERS: Final = 2 << 20
"""Number of characters that are looked at: a header of 32768 columns is a third of it."""

LONGEST_LINE: Final = 200
"""Number of characters of a line above the blocks that are looked at."""

MOST_BEFORE: Final = 200

SHAPE: Final = re.compile(r"^\W*(?:shape\b\W*)?\d+\s*[x×,;\s]\s*\d+\W*$", re.IGNORECASE)
DELIMITERS: Final = {",": '","', ";": '";"', "\t": '"\\t"', "|": '"|"', "whitespace": '"whitespace"'}

RATE: Final = re.compile(
    rf"(seconds?_per_frame|frame_?interval|period|frame_?rate|sampling_?rate|rate|frequency|fps)(?:\W*(?:s|hz)\b)?"
    rf"\W+({NUMBER})",
    re.IGNORECASE,
)

MOST_COLUMNS: Final = 12
"""A table with more columns holds a whole image in a row."""

FEWEST_TAXELS: Final = 4
"""Rows after which a count begins again, at least: fewer may be axes or flags."""

ROW_NAMES: Final = ("row", "r", "i")
COLUMN_NAMES: Final = ("col", "column", "c", "j")
TAXEL_NAMES: Final = ("taxel", "sensor", "channel", "index", "id")


def layout_hint(path: Path, form: CsvFormat, wanted: Sequence[str]) -> str:
    """Return the layout to set for a file that cannot be read as a table; '' if unknown."""
    plain = replace(form, skip_rows=0, skip_after_header=0, comment="")
    lines = text_lines(path, plain, Findings(), blank=True)
    filled = [(number, line) for number, line in lines or [] if line.strip()][:MOST_LINES]
    letters = accumulate(len(line) for _, line in filled)
    filled = [item for item, total in zip(filled, letters, strict=True) if total <= MOST_LETTERS]
    if not filled:
        return ""
    counted = bool(wanted) and all(name.isascii() and name.isdigit() for name in wanted)
    return (
        _shape_line(filled, form, counted=counted)
        or _labelled(filled)
        or _other_header(filled, form, wanted)
        or _transposed(filled, form, wanted)
        or _blocks([item for item in lines or [] if item[0] <= filled[-1][0]], plain)
        or (_headerless(filled, form, wanted) if counted else _lists(filled, form) or _long(filled, form))
        or ("" if counted else _unnamed(filled, form))
    )


def units_row(table: TextTable, numbers: Sequence[str]) -> str:
    """Return the advice for a table whose first row holds units or other words; '' if it does not."""
    words = [table.text(name)[:4] for name in numbers if table.text(name).dtype == object]
    if not words or not all(
        len(cells) > 1 and not _number(cells[0]) and all(_number(cell) for cell in cells[1:])
        for cells in words
    ):
        return ""
    shown = ", ".join(str(cells[0]) for cells in words[:4])
    return f"The line below the header holds words ({shown}): set skip_after_header = 1 in [csv]."


def _advice(
    seen: str, form: CsvFormat, mark: str, *, header: bool = True, skip_rows: int | None = None, end: str = "."
) -> str:  # fmt: skip
    """Return what was seen, and the lines of ``[csv]`` that read it; '' if all of them are there."""
    found = [] if skip_rows in (None, form.skip_rows) else [f"skip_rows = {skip_rows}"]
    found += ["header = false"] if form.header and not header else []
    found += [f"delimiter = {DELIMITERS[mark]}"] if mark != form.delimiter else []
    return f"{seen}: set {' and '.join(found)} in [csv]{end}" if found else ""


def _number(cell: str) -> bool:
    return cell == "" or bool(re.fullmatch(NUMBER, cell.replace(",", ".")))


def _shape_line(filled: Sequence[tuple[int, str]], form: CsvFormat, *, counted: bool) -> str:
    (number, line), following = filled[0], [text for _, text in filled[1:2]]
    alone = any(len(line.split()) < len(text.split()) or len(line) < len(text) for text in following)
    if not (SHAPE.match(line) and counted and alone and (form.header or form.skip_rows < number)):
        return ""
    return (
        f'Line {number} gives the shape of flat frames ("{line.strip()}"): set skip_rows = {number} and '
        "header = false in [csv]; without stamps, rate_hz too."
    )


def _labelled(filled: Sequence[tuple[int, str]]) -> str:
    paired = sum(len(PAIR.findall(line)) >= 2 for _, line in filled) > 0.8 * len(filled)
    return 'Its lines are pairs of name and value: set layout = "labelled" in [csv].' if paired else ""


def _cells(line: str, mark: str) -> list[str]:
    try:
        cells = line.split() if mark == "whitespace" else parse_csv(line, mark)[0]
    except (UnreadableError, IndexError):
        return []
    return [cell.strip() for cell in cells]


def _other_header(filled: Sequence[tuple[int, str]], form: CsvFormat, wanted: Sequence[str]) -> str:
    if not form.header:
        return ""
    for number, line in filled[:MOST_BEFORE]:
        for mark in DELIMITERS:
            if set(wanted) <= set(_cells(line, mark)):
                seen = f"Its columns are named in line {number}"
                return _advice(seen, form, mark, skip_rows=number - 1)
    return ""


def _transposed(filled: Sequence[tuple[int, str]], form: CsvFormat, wanted: Sequence[str]) -> str:
    """Return the advice for a table whose columns are samples: its first cells are the names."""
    for mark in dict.fromkeys((form.delimiter, *DELIMITERS)):
        if wanted and set(wanted) <= {cells[0] for _, line in filled if (cells := _cells(line, mark))}:
            sep = "" if mark == "," else f", sep={DELIMITERS.get(mark, repr(mark))}"
            return (
                "Its rows are columns: each line begins with a name, and samples follow one another along it. "
                f"Transpose it, with pandas by read_csv(..., header=None, index_col=0{sep}).T.to_csv(..., index=False)."
            )
    return ""


def _headerless(filled: Sequence[tuple[int, str]], form: CsvFormat, wanted: Sequence[str]) -> str:
    """Return the advice for rows of numbers without names, whose columns the mapping counts."""
    most = max(int(name) for name in wanted)
    number, line = filled[min(form.skip_rows, len(filled) - 1)]
    mark = next((m for m in (form.delimiter, *DELIMITERS) if len(_cells(line, m)) >= most), None)
    if mark is not None and all(_number(cell) for cell in _cells(line, mark)):
        seen = f"Line {number} holds {len(_cells(line, mark))} numbers"
        return _advice(seen, form, mark, header=False)
    width = next((len(_cells(line, m)) for m in DELIMITERS if len(_cells(line, m)) > 1), 1)
    if 1 < width < most and most % width == 0:
        return (
            f"Its lines hold {width} numbers, and the mapping counts {most} taxels: if {most // width} lines are a "
            f'frame, set layout = "blocks" and block_rows = {most // width} in [csv].'
        )
    return ""


def _unnamed(filled: Sequence[tuple[int, str]], form: CsvFormat) -> str:
    """Return the advice for rows of numbers without names, where the mapping has names."""
    number, line = filled[min(form.skip_rows, len(filled) - 1)]
    mark = max(DELIMITERS, key=lambda one: len(_cells(line, one)))
    cells = _cells(line, mark)
    if not form.header or len(cells) < 2 or not all(cell and _number(cell) for cell in cells):
        return ""
    seen, end = f"Line {number} holds {len(cells)} numbers and no names", f'"1" to "{len(cells)}"'
    return _advice(seen, form, mark, header=False, end=f"; its columns are then {end}.")


def _blocks(lines: list[tuple[int, str]], form: CsvFormat) -> str:
    blocks = blocks_of(lines, form)
    if not blocks:
        return ""
    (rows, cells), count = Counter(block.shape for block in blocks).most_common(1)[0]
    if count < 3 or rows < 2 or count <= 0.8 * len(blocks):
        return ""
    head = " ".join(line[:LONGEST_LINE] for number, line in lines if number < blocks[0].line)
    found = RATE.search(head)
    value = float(found[2]) if found else 0.0
    rate = "rate_hz gives the frames per second"
    if found and value > 0:
        hertz = 1 / value if re.search("second|interval|period", found[1], re.IGNORECASE) else value
        rate = f"rate_hz = {hertz:g} (its header says {found[0].strip()})"
    return (
        f"It holds blocks of {rows} rows of {cells} cells, one per frame, from line {blocks[0].line} on: set "
        f'layout = "blocks" in [csv]; taxels are then the columns "1" to "{rows * cells}". Without stamps, {rate}.'
    )


def _lists(filled: Sequence[tuple[int, str]], form: CsvFormat) -> str:
    rows = [_cells(line, form.delimiter) for _, line in filled[form.skip_rows : form.skip_rows + 2]]
    if not form.header or len(rows) < 2 or len(rows[0]) != len(rows[1]):
        return ""
    name = next((name for name, cell in zip(*rows, strict=True) if re.match(r"\[.*\]$", cell)), "")
    elements = f'its elements are the columns "{name}[0]", "{name}[1]", …'
    return f'The column "{name}" holds lists: {elements}.' if name else ""


def _long(filled: Sequence[tuple[int, str]], form: CsvFormat) -> str:
    rows = [_cells(line, form.delimiter) for _, line in filled[form.skip_rows :]]
    if not rows or not form.header:
        return ""
    keys = _named_keys(rows[0]) or _counted_keys(rows[0], rows[1 + form.skip_after_header :])
    if not keys:
        return ""
    shown = ", ".join(f'"{key}"' for key in keys)
    return (
        f"It seems to hold one row per taxel ({shown}), and a row has to be a sample: bring it into that form, with "
        f"pandas by table.pivot(index=..., columns=[{shown}], values=...)."
    )


def _named_keys(header: Sequence[str]) -> list[str]:
    """Return the columns that tell the taxel, by their names; none if they are not known."""
    names = {name.lower(): name for name in header}
    first = next((names[name] for name in (*ROW_NAMES, *TAXEL_NAMES) if name in names), None)
    if first is None or len(names) > MOST_COLUMNS:
        return []
    second = next((names[name] for name in COLUMN_NAMES if name in names and names[name] != first), None)
    if second is None and first.lower() in ROW_NAMES:
        return []
    return [first, second] if second else [first]


def _counted_keys(header: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Return the columns that tell the taxel, by their cells: whole numbers that recur in every frame, each once."""
    whole_rows = rows[:-1]  # the last one may be cut off
    if not whole_rows or len(header) > MOST_COLUMNS or any(len(row) != len(header) for row in whole_rows):
        return []
    columns = {name: list(cells) for name, cells in zip(header, zip(*whole_rows, strict=True), strict=True)}
    whole = {name: cells for name, cells in columns.items() if all(cell.isdecimal() for cell in cells)}
    best: tuple[str, ...] = ()
    most = FEWEST_TAXELS - 1
    for names in chain(combinations(whole, 1), combinations(whole, 2)):
        told = list(zip(*(whole[name] for name in names), strict=True))
        size = next((i for i in range(1, len(told)) if told[i] == told[0]), len(told))
        recurs = size <= len(told) / 3 and told[size:] == told[:-size] and len(set(told[:size])) == size
        # A column of a grid recurs within the frame: the whole frame is the longest that does.
        if recurs and size > most:
            best, most = names, size
    return list(best)
