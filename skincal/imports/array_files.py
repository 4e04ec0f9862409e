"""Files of arrays (MATLAB, NumPy, HDF5, Parquet, Feather, JSON) as named columns.

A one-dimensional array is a column with its name. A two-dimensional one gives the columns ``name[0]``, ``name[1]``, …,
a three-dimensional one ``name[0,0]``, …; samples run along the first axis. A list of equal arrays, one per sample, is
such an array as well. Dots and slashes join nested names. Readers raise ``ValueError`` for a damaged file.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Collection, Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, cast

import numpy as np
from numpy.typing import NDArray

from skincal.bounded import read_array, read_arrays
from skincal.dataset.findings import Findings
from skincal.errors import WorkError, quoted, text_of
from skincal.files import open_input
from skincal.imports.mapping_file import CsvFormat
from skincal.imports.recording import IntArray
from skincal.imports.text_table import MOST_NAMED, SourceSheet, TextTable, check_columns

Columns = dict[str, NDArray[Any]]
"""One-dimensional columns by name; their lengths may differ. A text without an axis says why a name has none."""

OBJECTS: Final = np.array("Python objects, which are not opened as they may run code", dtype=object)


def read_numpy(path: Path) -> Columns:
    """Return the columns of a ``.npz`` or ``.npy`` file, whose array is ``data``."""
    with open_input(path) as file:
        zipped = file.read(2) == b"PK"
    found = read_arrays(path, objects=OBJECTS) if zipped else {"data": read_array(path, objects=OBJECTS)}
    return _columns(found)


def read_matlab(path: Path) -> Columns:
    """Return the columns of a MATLAB file of version 4 to 7."""
    from scipy.io import loadmat

    with _damaged(text_of):
        loaded = loadmat(path, simplify_cells=True)
    return _columns({name: value for name, value in loaded.items() if not name.startswith("__")})


def read_hdf5(path: Path) -> Columns:
    """Return the columns of an HDF5 file, or of a MATLAB 7.3 file, whose arrays are transposed.

    Raises:
        WorkError: the library h5py is not installed.
    """
    try:
        import h5py as library  # pyright: ignore[reportMissingImports, reportMissingTypeStubs]
    except ImportError as error:
        needs = "reading it needs the library h5py: pip install skincal[hdf5]"
        raise WorkError(f"{path.name} is an HDF5 file; {needs}") from error
    h5py: Any = library
    arrays: dict[str, Any] = {}

    def content(name: str, item: Any, depth: int = 0) -> Any:
        if not isinstance(item, h5py.Dataset) or depth > 4:
            raise ValueError(f"{name} refers to no data; expected arrays, or cells of arrays")
        if item.external or item.is_virtual:  # a dataset may lie in any file of this computer
            raise ValueError(f"{name} lies in another file; expected data in {path.name} itself")
        array = item[()]
        if h5py.check_ref_dtype(item.dtype) is not None:  # cells of MATLAB
            return [content(name, item.file[cell], depth + 1) for cell in np.ravel(array)]
        return array.T if "MATLAB_class" in item.attrs else array

    def take(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset) and not name.startswith("#"):
            arrays[name] = content(name, item)

    with _damaged(text_of), h5py.File(path, "r") as file:
        file.visititems(take)
    return _columns(arrays)


def read_arrow(path: Path) -> Columns:
    """Return the columns of a Parquet or Feather file; an index with a name is one of them."""
    import pandas as pd

    with open_input(path) as file:
        feather = file.read(6) == b"ARROW1"
    table: Any = pd.read_feather(path) if feather else pd.read_parquet(path)
    if named := [name for name in table.index.names if name is not None]:
        table = table.reset_index(level=named)
    return _columns({str(name): column.to_numpy() for name, column in table.items()})


def read_json(path: Path) -> Columns:
    """Return the columns of a JSON file: one value per line, a list of samples, or a table of lists.

    Samples without names are lists of numbers; their columns are ``1``, ``2``, ….

    Raises:
        ValueError: the text is not JSON, or its samples differ in form.
    """
    with _damaged(quoted):
        text = path.read_text(encoding="utf-8-sig")
        try:
            value = json.loads(text)
        except json.JSONDecodeError:
            value = [json.loads(line) for line in text.splitlines() if line.strip()]
        if isinstance(value, Mapping):
            return _columns(cast("Mapping[str, Any]", value))
        samples = cast("list[Any]", value) if isinstance(value, list) else []
        if samples and all(isinstance(sample, Mapping) for sample in samples):
            return _columns(_by_key(samples))
        rows = np.array(samples, dtype=np.float64)
        return {str(i + 1): column for i, column in enumerate(rows.reshape(len(rows), -1).T)}


@contextmanager
def _damaged(words: Callable[[Exception], str]) -> Generator[None]:
    """Turn whatever parsers raise, for numbers and nesting without bounds, too, into an error with some words."""
    try:
        yield
    except MemoryError:
        raise
    except Exception as error:
        raise ValueError(words(error)) from error


def _columns(arrays: Mapping[str, Any]) -> dict[str, NDArray[Any]]:
    flat = dict(_arrays(arrays, ""))
    flat = {name: one.ravel() if one.ndim == 2 and 1 in one.shape else one for name, one in flat.items()}
    # Samples run along the axis that is as long as the one-dimensional columns.
    lengths = {array.size for array in flat.values() if array.ndim == 1}
    found: dict[str, NDArray[Any]] = {}
    for name, array in flat.items():
        while array.ndim > 3 and array.shape[-1] == 1:
            array = array[..., 0]
        if array.ndim < 2:
            found[name] = array
        else:
            if array.shape[0] not in lengths and array.shape[-1] in lengths:
                array = np.moveaxis(array, -1, 0)
            for index in np.ndindex(*array.shape[1:]):
                found[f"{name}[{','.join(map(str, index))}]"] = array[(slice(None), *index)]
    return found


def _arrays(values: Mapping[str, Any], prefix: str) -> Iterator[tuple[str, NDArray[Any]]]:
    for name, value in values.items():
        full = f"{prefix}{name}"
        if isinstance(value, Mapping):
            yield from _arrays(cast("Mapping[str, Any]", value), f"{full}.")
            continue
        if parts := _tables(value):
            yield from _arrays({f"{name}[{i}]": one for i, one in enumerate(parts)}, prefix)
            continue
        array = _array(value)
        if isinstance(array, Mapping):
            yield from _arrays(array, f"{full}.")
        elif array.dtype.names:
            yield from _arrays({field: array[field] for field in array.dtype.names}, f"{full}.")
        elif (array.size and array.dtype.kind in "biufMSUO") if array.ndim else _says_why(array):
            yield full, array


def _tables(value: Any) -> list[list[Any]]:
    """Return a list of tables per sample as a list of samples per table; none for anything else."""
    rows = cast("list[Any]", value) if isinstance(value, list) else []
    lists = [cast("Sequence[Any]", row) for row in rows if isinstance(row, list | np.ndarray)]
    tables = any(len(row) and all(isinstance(one, Mapping) for one in row) for row in lists)
    if not tables or len(lists) < len(rows) or len({*map(len, lists)}) > 1:
        return []
    # A sample that lacks the list has numbers that are missing in its place.
    return [[one if isinstance(one, Mapping) else {} for one in part] for part in zip(*lists, strict=True)]


def _says_why(array: NDArray[Any]) -> bool:
    """Return whether an array stands for one that gives no column."""
    return array.dtype == object and not array.ndim and isinstance(array.item(), str)


def _array(value: Any) -> NDArray[Any] | Mapping[str, Any]:
    """Return a value as an array; a list with a table per sample as a table of lists."""
    listed = isinstance(value, list) or getattr(getattr(value, "dtype", None), "kind", "") == "O"
    alone = isinstance(value, np.ndarray) and not value.ndim
    if not listed or alone:
        return np.asarray(cast("Any", value))
    items = list(cast("Sequence[Any]", value))
    if items and all(isinstance(item, Mapping) for item in items):
        return _by_key(items)
    if any(isinstance(item, list | np.ndarray) for item in items):
        try:
            return np.stack([_nested(item) for item in items])
        except ValueError:  # arrays of different shapes are no column
            sizes = Counter(np.size(item) for item in items)
            usual = sizes.most_common(1)[0][0]
            row = next((i for i, item in enumerate(items) if np.size(item) != usual), 0)
            got = f"lists of {usual} numbers, and of {np.size(items[row])} in row {row + 1}"
            return np.array(got, dtype=object)
    numbers = all(isinstance(item, bool | int | float | np.number) for item in items)
    return np.array(items, dtype=None if numbers else object)


def _nested(value: Any) -> NDArray[Any]:
    """Return lists of lists, which Parquet reads as arrays of arrays, as one array."""
    array = np.asarray(value)
    if (
        array.dtype != object
        or not array.size
        or not all(isinstance(item, list | np.ndarray) for item in array)
    ):
        return array
    return np.stack([_nested(item) for item in array])


def _by_key(samples: Sequence[Mapping[str, Any]]) -> dict[str, list[Any]]:
    """Return the values of tables by their keys; NaN where a table lacks a number, '' where it lacks a text."""
    blank: dict[str, Any] = {}
    for sample in samples:
        for key, value in sample.items():
            if key not in blank:
                empty: Any = {} if isinstance(value, Mapping) else "" if isinstance(value, str) else np.nan
                is_list = isinstance(value, list | np.ndarray)
                blank[key] = np.full(np.shape(cast("Any", value)), np.nan) if is_list else empty
    return {key: [sample.get(key, empty) for sample in samples] for key, empty in blank.items()}


def table_of(
    file: str, columns: Columns, numbers: Collection[str], texts: Collection[str], form: CsvFormat, findings: Findings,
    lines: IntArray | None = None, hint: str = "",
) -> TextTable | None:  # fmt: skip
    """Return a table of the required columns; None, with errors, if some are missing or differ in length."""
    wanted = [*dict.fromkeys((*numbers, *texts))]
    # MATLAB's structures have slashes in files of version 7.3, and dots in older ones.
    dotted = {name.replace("/", "."): column for name, column in columns.items()}
    slashed = {name: dotted[name.replace("/", ".")] for name in wanted if name.replace("/", ".") in dotted}
    columns = slashed | columns
    no_columns = {name: column.item() for name, column in columns.items() if not column.ndim}
    columns = {name: column for name, column in columns.items() if column.ndim}
    refused = [name for name in no_columns if not columns or name in {name.split("[")[0] for name in wanted}]
    for name in refused:
        fix = f"Give its lists one length (NaN for what is missing), and save numpy.array(list({name}), dtype=float)."
        findings.error(f'{file}, "{name}"', "an array of numbers", no_columns[name], fix)
    if refused or not check_columns(file, columns, wanted, findings, hint):
        return None
    sizes = {len(columns[name]) for name in wanted}
    if len(sizes) > 1:
        got = ", ".join(f"{name}: {len(columns[name])}" for name in wanted[:MOST_NAMED])
        fix = "Columns of another length have their own clock: add the file to [files] as well."
        findings.error(file, "columns of one length", got, fix)
        return None
    rows = sizes.pop() if sizes else max(map(len, columns.values()), default=0)
    cells = {name: _cells(columns[name], text=name in texts) for name in wanted}
    return TextTable(SourceSheet(findings, file, lines), cells, rows, form)


def _cells(column: NDArray[Any], *, text: bool) -> NDArray[Any]:
    """Return a column as numbers, or as texts; bytes that are no text show in the error of what should be a number."""
    if column.dtype.kind in "biuf" and not text:
        return column.astype(np.float64)
    cells = np.datetime_as_string(column) if column.dtype.kind == "M" else column
    words = [cell.decode(errors="backslashreplace") if isinstance(cell, bytes) else cell for cell in cells]
    return np.array(["" if word is None else str(word) for word in words], dtype=object)
