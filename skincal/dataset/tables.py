"""The tables of a dataset as frozen objects over read-only arrays: presses, frames, taxel positions."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Mapping
from copy import copy
from dataclasses import dataclass, field, fields, replace
from types import MappingProxyType
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

PHASES = ("idle", "load", "hold", "unload")
"""Names of the phases; ``Frames.phase`` holds their index."""

IDLE, LOAD, HOLD, UNLOAD = range(4)


@dataclass(frozen=True)
class _Table:
    """Rows of arrays of equal length; a selection of rows is a table of the same kind."""

    @property
    def columns_by_name(self) -> Mapping[str, NDArray[Any]]:
        """The columns without an attribute of their own."""
        return self.columns  # type: ignore[attr-defined]

    def __len__(self) -> int:
        return len(self.press)  # type: ignore[attr-defined]

    def column(self, name: str) -> NDArray[Any] | None:
        """Return an optional column, shape (rows,); None if the table does not have it."""
        return self.columns_by_name.get(name)

    def select(self, rows: ArrayLike) -> Self:
        """Return the table with only these rows: a boolean mask, shape (rows,), or indices in any order."""
        index = np.asarray(rows)
        changes: dict[str, Any] = {}
        for item in fields(self):
            value = getattr(self, item.name)
            if isinstance(value, np.ndarray):
                changes[item.name] = value[index]
            elif isinstance(value, Mapping):
                changes[item.name] = {name: column[index] for name, column in value.items()}
        return replace(self, **changes)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle by the constructor: a read-only view of a mapping is none that pickle knows."""
        values = (getattr(self, item.name) for item in fields(self))
        return type(self), tuple(dict(v) if isinstance(v, MappingProxyType) else v for v in values)

    def _freeze(self, types: Mapping[str, tuple[Any, tuple[int | None, ...]]]) -> None:
        """Make the arrays read-only, with their type and the shape of a row; None: any length."""
        rows = len(np.asarray(self.press))  # type: ignore[attr-defined]
        for name, (dtype, shape) in types.items():
            if getattr(self, name) is not None:
                array = np.asarray(getattr(self, name), dtype=dtype)
                object.__setattr__(self, name, _read_only(_shaped(name, array, (rows, *shape))))
        columns = {
            name: _read_only(_shaped(name, np.asarray(column), (rows,)))
            for name, column in self.columns_by_name.items()
        }
        object.__setattr__(self, "columns", MappingProxyType(columns))


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

    def __post_init__(self) -> None:
        self._freeze(
            {
                "press": (np.int64, ()),
                "position_m": (np.float64, (3,)),
                "force_n": (np.float64, ()),
                "counts": (np.float64, (None,)),
                "normals": (np.float64, (3,)),
            }
        )


class FrameColumns(Mapping[str, NDArray[Any]]):
    """Columns of frames that are stored in a file; the mapping holds the columns other than taxels."""

    taxels: tuple[str, ...]

    @abstractmethod
    def taxel(self, j: int) -> FloatArray:
        """Return the counts of the taxel with flat index ``j``, shape (M,)."""


@dataclass(frozen=True, eq=False)
class Frames(_Table):
    """The table of frames, one row per time sample, in the order of time over the session.

    Attributes:
        press: number of the press, -1 where nothing touches, shape (M,).
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

    def __post_init__(self) -> None:
        self._freeze(
            {
                "press": (np.int64, ()),
                "phase": (np.int8, ()),
                "time_s": (np.float64, ()),
                "force_n": (np.float64, ()),
                "position_m": (np.float64, (3,)),
                "counts": (np.float64, (None,)),
            }
        )

    @classmethod
    def stored(cls, source: FrameColumns, **own: NDArray[Any]) -> Self:
        """Return frames whose counts and columns are read from a file on use.

        Args:
            source: the file's columns.
            own: the attributes that precede ``counts``.
        """
        frames = cls(**own, counts=np.empty((len(own["press"]), 0)))  # type: ignore[arg-type]
        object.__delattr__(frames, "counts")
        object.__setattr__(frames, "columns", source)
        return frames

    def __getattr__(self, name: str) -> Any:
        source = self.__dict__.get("columns")
        if name != "counts" or not isinstance(source, FrameColumns):
            raise AttributeError(name)
        counts = np.empty((len(self), len(source.taxels)))
        for j in range(len(source.taxels)):
            counts[:, j] = source.taxel(j)
        object.__setattr__(self, "counts", _read_only(counts))
        return self.counts

    def taxel_columns(self) -> Iterator[FloatArray]:
        """Yield the counts (M,) of one taxel after the other, in the order of the flat index."""
        source = self.columns
        if "counts" in self.__dict__ or not isinstance(source, FrameColumns):
            yield from self.counts.T
            return
        for j in range(len(source.taxels)):
            yield source.taxel(j)

    def counts_of(self, rows: IntArray) -> FloatArray:
        """Return the counts (n, J) of some rows (n,), without loading all of them."""
        return np.stack([column[rows] for column in self.taxel_columns()], axis=1)

    def moved(self, position_m: FloatArray, force_n: FloatArray) -> Self:
        """Return the same frames with other contacts; columns stored in a file stay there."""
        frames = copy(self)
        for name, values in (("position_m", position_m), ("force_n", force_n)):
            object.__setattr__(frames, name, _read_only(_shaped(name, values, getattr(self, name).shape)))
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
        object.__setattr__(self, "centres_m", _read_only(np.asarray(self.centres_m, dtype=float)))
        object.__setattr__(self, "sizes_m", _read_only(np.asarray(self.sizes_m, dtype=float)))


def _shaped(name: str, array: NDArray[Any], shape: tuple[int | None, ...]) -> NDArray[Any]:
    if array.ndim != len(shape) or any(
        want is not None and want != n for want, n in zip(shape, array.shape, strict=True)
    ):
        raise ValueError(f"{name}: expected shape {shape}; got {array.shape}")
    return array


def _read_only(array: NDArray[Any]) -> NDArray[Any]:
    """Return a read-only view; the caller's own array stays writable."""
    view = array.view()
    view.flags.writeable = False
    return view
