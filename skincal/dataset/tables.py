"""The tables of a dataset as frozen objects over read-only arrays: presses, frames, taxel positions."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, fields, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skincal.covariates import NORMAL, POSITION
from skincal.model.arrays import FloatArray, IntArray

if TYPE_CHECKING:
    import pandas as pd


PHASES = ("idle", "load", "hold", "unload")
"""Names of the phases; ``Frames.phase`` holds their index."""

IDLE, LOAD, HOLD, UNLOAD = range(4)


class LazyColumns(Mapping[str, NDArray[Any]]):
    """Columns that a function reads from their file by name at every use; they are not cached."""

    def __init__(self, names: Iterable[str], read: Callable[[str], NDArray[Any]]) -> None:
        self._names, self._read = dict.fromkeys(names), read

    def __getitem__(self, name: str) -> NDArray[Any]:
        if name not in self._names:
            raise KeyError(name)
        return self._read(name)

    def __contains__(self, name: object) -> bool:
        return name in self._names

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)


class _Table:
    """Rows of arrays of equal length; a selection of rows is a table of the same kind."""

    press: IntArray
    columns: Mapping[str, NDArray[Any]]

    names: ClassVar[Mapping[str, tuple[str, ...]]]
    """Columns of the file for each attribute; those of ``counts`` depend on the sensor."""

    types: ClassVar[Mapping[str, Any]] = {"press": np.int64, "phase": np.int8}
    """Types of the attributes that are not measurements."""

    def __post_init__(self) -> None:
        rows = len(np.asarray(self.press))
        for name, own in self.names.items():
            if (value := getattr(self, name)) is not None:
                array = np.asarray(value, dtype=self.types.get(name, np.float64))
                object.__setattr__(self, name, _read_only(_shaped(name, array, (rows, len(own)))))
        if not isinstance(self.columns, LazyColumns):
            given = {name: np.asarray(column) for name, column in self.columns.items()}
            own = {name: _read_only(_shaped(name, column, (rows, 1))) for name, column in given.items()}
            object.__setattr__(self, "columns", MappingProxyType(own))

    def __len__(self) -> int:
        return len(self.press)

    def column(self, name: str) -> NDArray[Any] | None:
        """Return an optional column, shape (rows,); None if the table does not have it."""
        return self.columns.get(name)

    def vectors(self, names: Sequence[str]) -> FloatArray | None:
        """Return optional columns side by side, shape (rows, columns); None if one is missing."""
        found = [self.columns[name] for name in names if name in self.columns]
        return np.column_stack(found) if len(found) == len(names) else None

    def select(self, rows: ArrayLike) -> Self:
        """Return the table with only these rows: a boolean mask, shape (rows,), or indices in any order."""
        index = np.asarray(rows)
        changes: dict[str, Any] = {}
        for item in fields(self):  # type: ignore[arg-type]
            value = getattr(self, item.name)
            if isinstance(value, np.ndarray):
                changes[item.name] = value[index]
            elif isinstance(value, Mapping):
                changes[item.name] = {name: column[index] for name, column in value.items()}
        return replace(self, **changes)  # type: ignore[type-var]

    def __getstate__(self) -> dict[str, Any]:
        """Return a state that can be pickled; columns that are read on use stay in their file."""
        return {k: dict(v) if isinstance(v, MappingProxyType) else v for k, v in vars(self).items()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        for name, value in state.items():
            own = MappingProxyType(value) if isinstance(value, dict) else value
            vars(self)[name] = _read_only(own) if isinstance(own, np.ndarray) else own

    def to_columns(self, taxels: Sequence[str]) -> dict[str, Any]:
        """Return the columns of the file by name, NaN or '' where not measured.

        ``taxels`` are the names of the taxel columns, ``sensor.taxel_columns()``.
        """
        parts: dict[str, Any] = {}
        for name, own in self.names.items():
            if name == "phase":
                parts[name] = np.array(PHASES, dtype=object)[getattr(self, name)]
            elif (value := getattr(self, name)) is not None:
                parts |= zip(own or taxels, np.atleast_2d(value.T), strict=True)
        return parts | dict(self.columns)

    def to_pandas(self, taxels: Sequence[str]) -> pd.DataFrame:
        """Return :meth:`to_columns` as a data frame."""
        import pandas as pd

        return pd.DataFrame(self.to_columns(taxels))

    @classmethod
    def of_pandas(cls, table: pd.DataFrame, taxels: Sequence[str]) -> Self:
        """Return the table of a data frame; the inverse of :meth:`to_pandas`."""
        own: dict[str, Any] = {}
        for name, names in cls.names.items():
            names = tuple(taxels) if name == "counts" else names
            if not set(names) <= set(table):
                continue
            if name == "phase":
                own[name] = table[name].map(dict(zip(PHASES, range(4), strict=True))).to_numpy()
            else:
                own[name] = table[names[0] if len(names) == 1 and name != "counts" else [*names]].to_numpy()
        taken = {*taxels, *(one for names in cls.names.values() for one in names)}
        own["columns"] = {name: _plain(table[name]) for name in table if name not in taken}
        return cls(**own)


@dataclass(frozen=True, eq=False)
class Presses(_Table):
    """The table of presses, one row per press.

    Attributes:
        press: number of the press, unique, shape (K,).
        position_m: measured contact point, fingertip frame [m], shape (K, 3); NaN where not measured.
        force_n: mean normal force in the hold [N], shape (K,).
        counts: mean image in the hold [counts], shape (K, J); NaN where a taxel is dead.
        normals: measured outward normals, shape (K, 3), NaN where not measured; None: the surface's own.
        columns: all other columns, known or not; text columns hold ``str``, '' where not given.

    Raises:
        ValueError: the arrays do not have these shapes.
    """

    press: IntArray
    position_m: FloatArray
    force_n: FloatArray
    counts: FloatArray
    normals: FloatArray | None = None
    columns: Mapping[str, NDArray[Any]] = field(default_factory=dict)

    names: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "press": ("press",),
        "position_m": POSITION,
        "force_n": ("force_n",),
        "normals": NORMAL,
        "counts": (),
    }


@dataclass(frozen=True, eq=False)
class Frames(_Table):
    """The table of frames, one row per time sample, in the order of time over the session.

    Attributes:
        press: number of the press, -1 without contact, shape (M,).
        phase: index into :data:`PHASES`, shape (M,).
        time_s: session clock [s], shape (M,).
        force_n: normal force [N], shape (M,).
        position_m: contact point, fingertip frame [m], shape (M, 3); NaN in idle frames.
        counts: image [counts], shape (M, J); NaN where a taxel is dead. :meth:`taxel_columns` needs less memory.
        columns: all other columns, known or not.
    """

    press: IntArray
    phase: NDArray[np.int8]
    time_s: FloatArray
    force_n: FloatArray
    position_m: FloatArray
    counts: FloatArray
    columns: Mapping[str, NDArray[Any]] = field(default_factory=dict)

    names: ClassVar[Mapping[str, tuple[str, ...]]] = {
        **{name: (name,) for name in ("press", "phase", "time_s", "force_n")},
        "position_m": POSITION,
        "counts": (),
    }

    @classmethod
    def from_file(cls, taxels: LazyColumns, columns: LazyColumns, **own: NDArray[Any]) -> Self:
        """Return frames whose counts and other columns are read from a file on use."""
        frames = cls(**own, counts=np.empty((len(own["press"]), 0)), columns=columns)  # type: ignore[arg-type]
        object.__delattr__(frames, "counts")
        object.__setattr__(frames, "_taxels", taxels)
        return frames

    def __getattr__(self, name: str) -> Any:
        taxels = self.__dict__.get("_taxels")
        if name != "counts" or taxels is None:
            raise AttributeError(name)
        counts = np.empty((len(self), len(taxels)))
        for j, column in enumerate(taxels.values()):
            counts[:, j] = column
        object.__setattr__(self, "counts", _read_only(counts))
        return self.counts

    def taxel_columns(self) -> Iterator[FloatArray]:
        """Yield the counts (M,) of one taxel after the other, in the order of the flat index."""
        yield from self.counts.T if "counts" in self.__dict__ else self.__dict__["_taxels"].values()

    def counts_of(self, rows: IntArray) -> FloatArray:
        """Return the counts (n, J) of some rows (n,), without loading all of them."""
        return np.stack([column[rows] for column in self.taxel_columns()], axis=1)

    def drop_above(self, limit: FloatArray) -> Self:
        """Return the frames with readings at or above ``limit`` (J,) set to NaN; columns in a file stay there."""
        if "counts" in self.__dict__:
            return replace(self, counts=np.where(self.counts < limit, self.counts, np.nan))
        taxels = self.__dict__["_taxels"]
        limits = dict(zip(taxels, limit.tolist(), strict=True))
        frames = copy(self)

        def read(name: str) -> FloatArray:
            column = taxels[name]
            return np.where(column < limits[name], column, np.nan)

        object.__setattr__(frames, "_taxels", LazyColumns(taxels, read))
        return frames

    def moved(self, position_m: FloatArray, force_n: FloatArray) -> Self:
        """Return the frames with new contact positions (M, 3) [m] and forces (M,) [N]; columns in a file stay there."""
        frames = copy(self)
        for name, values in (("position_m", position_m), ("force_n", force_n)):
            values = _shaped(name, values, (len(self), len(self.names[name])))
            object.__setattr__(frames, name, _read_only(values))
        return frames


@dataclass(frozen=True, eq=False)
class TaxelPositions:
    """Positions of taxels that form no grid, in the order of the flat index.

    Attributes:
        centres_m: patch coordinates ``(u, v)`` of the centres [m], shape (J, 2).
        sizes_m: extents along ``(u, v)`` [m], shape (J, 2).
    """

    centres_m: FloatArray
    sizes_m: FloatArray

    def __post_init__(self) -> None:
        for name in ("centres_m", "sizes_m"):
            object.__setattr__(self, name, _read_only(np.asarray(getattr(self, name), dtype=float)))


def _shaped(name: str, array: NDArray[Any], shape: tuple[int, int]) -> NDArray[Any]:
    """Return an array after checking its shape (rows, columns); 1 column: shape (rows,), 0: any number of columns."""
    rows, columns = shape
    want = (rows,) if columns == 1 else (rows, columns or (array.shape[1] if array.ndim == 2 else None))
    if array.shape != want:
        raise ValueError(f"{name}: expected shape {want}; got {array.shape}")
    return array


def _read_only(array: NDArray[Any]) -> NDArray[Any]:
    """Return a read-only view; the caller's own array stays writable."""
    view = array.view()
    view.flags.writeable = False
    return view


def _plain(column: pd.Series) -> NDArray[Any]:
    """Return a column as an array; texts are objects, '' where missing."""
    numeric = column.dtype.kind in "biuf"
    return column.to_numpy() if numeric else column.astype(object).fillna("").to_numpy(dtype=object)
