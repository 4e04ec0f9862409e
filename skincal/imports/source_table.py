"""The single place where files become tables: one reader per format, and messages for other kinds of file.

Every reader gives a :class:`~skincal.imports.text_table.TextTable` with the columns that a mapping needs.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from typing import Final

from skincal.bounded import UnreadableError
from skincal.dataset.findings import Findings
from skincal.errors import text_of
from skincal.files import open_input, reason
from skincal.imports import array_files as arrays
from skincal.imports.apart import apart
from skincal.imports.frame_text import read_blocks, read_labelled
from skincal.imports.layout_hints import layout_hint, units_row
from skincal.imports.mapping_file import CsvFormat
from skincal.imports.text_table import UTF_16, TextTable, read_text_table

ARRAYS: Final[dict[bytes, Callable[[Path], arrays.Columns]]] = {
    b"\x89HDF\r\n\x1a\n": arrays.read_hdf5,
    b"MATLAB 5.0 MAT": arrays.read_matlab,
    b"MATLAB 7.3 MAT": arrays.read_hdf5,
    b"PAR1": arrays.read_arrow,
    b"ARROW1": arrays.read_arrow,
    b"\x93NUMPY": arrays.read_numpy,
}
"""Readers of binary files by their first bytes."""

REFUSED: Final = {
    b"\x89MCAP": ("an MCAP recording", "Use `skincal import rosbag`, or write its channels as .csv or .npz."),
    b"#ROSBAG": ("a ROS 1 bag", "Use `skincal import rosbag`."),
    b"SQLite format 3": (
        "an SQLite database",
        "Is it a ROS 2 bag? Use `skincal import rosbag` with its folder.",
    ),
    b"\xd0\xcf\x11\xe0": ("an Excel workbook", "Save the sheet as CSV."),
    b"\x1f\x8b": ("a file compressed by gzip", "Unpack it first."),
    b"BZh": ("a file compressed by bzip2", "Unpack it first."),
    b"\xfd7zXZ": ("a file compressed by xz", "Unpack it first."),
    b"TDSm": ("a LabVIEW TDMS file", "Export it as CSV, or as .mat."),
    **dict.fromkeys(
        (b"\x80\x02", b"\x80\x03", b"\x80\x04", b"\x80\x05"),
        ("a Python pickle", "It is not opened, as it may run code; save the arrays by numpy.savez."),
    ),
}
"""First bytes of unsupported files: their kind, and advice."""

SPREADSHEETS: Final = (".xlsx", ".xlsm", ".ods")
READ: Final = "text, JSON, .mat, .npz, .npy, HDF5, Parquet or Feather"


def read_source_tables(
    paths: Sequence[Path], form: CsvFormat, numbers: Collection[str], texts: Collection[str], findings: Findings
) -> list[TextTable]:  # fmt: skip
    """Return the required columns of some files; errors are added for those that do not hold them."""
    tables = [read_source_table(path, form, numbers, texts, findings) for path in paths]
    return [table for table in tables if table is not None]


def read_source_table(
    path: Path, form: CsvFormat, numbers: Collection[str], texts: Collection[str], findings: Findings
) -> TextTable | None:
    """Read the required columns; None, with errors, if the file does not hold them."""
    try:
        with open_input(path) as file:
            head = file.read(4096)
    except OSError as error:
        findings.error(str(path), "a file to read", reason(error))
        return None
    reader = next((reader for magic, reader in ARRAYS.items() if head.startswith(magic)), None)
    if reader is None and path.suffix.lower() == ".mat" and b"\0" in head:
        reader = arrays.read_matlab  # version 4 has no first bytes of its own
    if head.startswith(b"PK\x03\x04"):
        reader = None if path.suffix.lower() in (*SPREADSHEETS, ".zip") else arrays.read_numpy
    start = head.removeprefix(b"\xef\xbb\xbf").lstrip()[:1]
    if form.layout == "table" and start in (b"{", b"["):
        reader = arrays.read_json
    if reader is not None:
        try:
            columns = apart(reader, path)  # libraries crash, or take all memory, on a damaged file
        except (OSError, ValueError) as error:
            if start != b"[":
                got = error.got if isinstance(error, UnreadableError) else text_of(error)
                findings.error(path.name, f"a whole file of arrays ({READ})", got, "Was it cut short?")
                return None
        else:
            return arrays.table_of(path.name, columns, numbers, texts, form, findings)
    if kind := _refused(path, head, form):
        findings.error(path.name, READ, *kind)
        return None
    if form.layout == "blocks":
        return read_blocks(path, form, numbers, texts, findings)
    if form.layout == "labelled":
        return read_labelled(path, form, numbers, texts, findings)
    before = len(findings.errors)
    table = read_text_table(path, form, numbers, texts, findings)
    wanted = [*dict.fromkeys((*numbers, *texts))]
    hint = layout_hint(path, form, wanted) if table is None else units_row(table, [*numbers])
    if not hint:
        return table
    del findings.errors[before:]
    findings.error(path.name, "a table: one row a sample, one column a taxel", "another layout", hint)
    return None


def _refused(path: Path, head: bytes, form: CsvFormat) -> tuple[str, str] | None:
    if known := next((kind for magic, kind in REFUSED.items() if head.startswith(magic)), None):
        return known
    if head.startswith(b"PK\x03\x04"):
        if path.suffix.lower() in SPREADSHEETS:
            return "a spreadsheet", "Save the sheet as CSV."
        return "a zip archive", "Unpack it first."
    wide = form.encoding.lower().replace("_", "-").startswith(("utf-16", "utf-32"))
    if b"\0" in head and not head.startswith(UTF_16) and not wide:
        return f'a binary file of an unknown kind ("{path.suffix}")', "Export it as CSV, .mat or .npz."
    return None
