"""Checked, read-only arrays for the frozen objects of the model."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

_Item = TypeVar("_Item", bound=np.generic)


def floats(name: str, value: ArrayLike, shape: Sequence[int | None], *, finite: bool = True) -> FloatArray:
    """Return a read-only float array of the given shape, a copy.

    Args:
        name: what the array is called, for the error.
        value: anything numpy can turn into an array; it is copied.
        shape: length of each axis; ``None`` where any length is allowed.
        finite: refuse NaN and infinity.

    Raises:
        ValueError: the shape differs, or a value is not finite.
    """
    array = np.array(value, dtype=np.float64)
    check_shape(name, array, shape)
    if finite and not np.all(np.isfinite(array)):
        bad = np.argwhere(~np.isfinite(array))
        raise ValueError(
            f"{name}: expected finite numbers; got {len(bad)} that are not, first at {bad[0].tolist()}"
        )
    return frozen(array)


def as_floats(value: ArrayLike) -> FloatArray:
    """Return the value as a float array, without a copy if it is one already."""
    return np.asarray(value, dtype=np.float64)


def check_shape(name: str, array: NDArray[Any], shape: Sequence[int | None]) -> None:
    """Raise ``ValueError`` unless the array has the shape; ``None`` stands for any length."""
    fits = array.ndim == len(shape) and all(
        want in (None, got) for want, got in zip(shape, array.shape, strict=True)
    )
    if not fits:
        want = tuple("any" if n is None else n for n in shape)
        raise ValueError(f"{name}: expected shape {want}; got {array.shape}")


def frozen(array: NDArray[_Item]) -> NDArray[_Item]:
    """Make an array read-only, and return it."""
    array.setflags(write=False)
    return array


def positive(name: str, value: float) -> float:
    """Return the value as a float.

    Raises:
        ValueError: the value is not finite, or not greater than zero.
    """
    number = float(value)
    if not (np.isfinite(number) and number > 0):
        raise ValueError(f"{name}: expected a finite number > 0; got {value!r}")
    return number


def unit_rows(name: str, value: ArrayLike, *, finite: bool = True) -> FloatArray:
    """Return read-only unit vectors (K, 3), normalised to double precision.

    Raises:
        ValueError: the length of a row differs from 1 by more than 1e-6. Rows with NaN pass if ``finite`` is false.
    """
    rows = floats(name, value, (None, 3), finite=finite)
    length = np.linalg.norm(rows, axis=1)
    bad = np.flatnonzero(np.abs(length - 1) > 1e-6)
    if bad.size:
        raise ValueError(f"{name}: expected unit vectors; got length {length[bad[0]]:.6g} in row {bad[0]}")
    return frozen(rows / length[:, None])
