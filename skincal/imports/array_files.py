"""Binary files of arrays (MATLAB, NumPy, HDF5, Parquet) as named columns.

A one-dimensional array is a column with its name. A two-dimensional one gives the columns ``name[0]``, ``name[1]``, …,
a three-dimensional one ``name[0,0]``, …; samples run along the first axis. Dots and slashes join nested names.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skincal.bounded import read_array, read_arrays
from skincal.errors import WorkError
from skincal.files import open_input
from skincal.imports.columns_of import Columns


def read_numpy(path: Path) -> Columns:
    """Return the columns of a ``.npz`` or ``.npy`` file; the array of the latter is called ``data``.

    Raises:
        ValueError: the file is damaged, or holds objects, which would run code.
    """
    with open_input(path) as file:
        zipped = file.read(2) == b"PK"
    return _columns(read_arrays(path) if zipped else {"data": read_array(path)})


def read_matlab(path: Path) -> Columns:
    """Return the columns of a MATLAB file up to version 7.

    Raises:
        ValueError: the file is damaged.
    """
    from scipy.io import loadmat

    try:
        loaded = loadmat(path, simplify_cells=True)
    except MemoryError:
        raise
    except Exception as error:  # the library raises whatever its parsers raise
        raise ValueError(str(error)) from error
    return _columns({name: value for name, value in loaded.items() if not name.startswith("__")})


def read_hdf5(path: Path) -> Columns:
    """Return the columns of an HDF5 file, or of a MATLAB 7.3 file, whose arrays are transposed.

    Raises:
        ValueError: it is damaged.
        WorkError: the library h5py is not installed.
    """
    try:
        import h5py as library  # pyright: ignore[reportMissingImports, reportMissingTypeStubs]
    except ImportError as error:
        raise WorkError(
            f"{path.name} is an HDF5 file; reading it needs the library h5py: pip install skincal[hdf5]"
        ) from error
    h5py: Any = library
    arrays: dict[str, Any] = {}

    def take(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset) and not name.startswith("#"):
            if item.external or item.is_virtual:  # a dataset may lie in any file of this computer
                raise ValueError(f"{name} lies in another file; expected data in {path.name} itself")
            arrays[name] = item[()].T if "MATLAB_class" in item.attrs else item[()]

    try:
        with h5py.File(path, "r") as file:
            file.visititems(take)
    except MemoryError:
        raise
    except Exception as error:  # the library raises whatever its parsers raise
        raise ValueError(str(error)) from error
    return _columns(arrays)


def read_parquet(path: Path) -> Columns:
    """Return the columns of a Parquet file.

    Raises:
        ValueError: the file is damaged.
    """
    import pandas as pd

    return _columns({str(name): column.to_numpy() for name, column in pd.read_parquet(path).items()})


def _columns(arrays: Mapping[str, Any]) -> dict[str, NDArray[Any]]:
    flat = dict(_arrays(arrays, ""))
    # Samples run along the axis that is as long as the one-dimensional columns.
    lengths = {
        array.size for array in flat.values() if array.ndim == 1 or (1 in array.shape[:2] and array.ndim == 2)
    }
    found: dict[str, NDArray[Any]] = {}
    for name, array in flat.items():
        if array.ndim == 2 and 1 in array.shape:
            found[name] = array.ravel()
        elif array.ndim == 1:
            found[name] = array
        elif array.ndim in (2, 3):
            if array.shape[0] not in lengths and array.shape[-1] in lengths:
                array = np.moveaxis(array, -1, 0)
            for index in np.ndindex(*array.shape[1:]):
                found[f"{name}[{','.join(map(str, index))}]"] = array[(slice(None), *index)]
    return found


def _arrays(values: Mapping[str, Any], prefix: str) -> Iterator[tuple[str, NDArray[Any]]]:
    for name, value in values.items():
        full = f"{prefix}{name}"
        if isinstance(value, Mapping):
            yield from _arrays(value, f"{full}.")  # pyright: ignore[reportUnknownArgumentType]
            continue
        array = np.asarray(value)
        if array.dtype.names:
            yield from _arrays({field: array[field] for field in array.dtype.names}, f"{full}.")
        elif array.ndim and (array.dtype.kind in "biufMSUO"):
            yield full, array
