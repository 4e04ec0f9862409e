"""Orders of taxels that a reading order or a cable can cause, and their lines in a mapping file."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from skincal.fitting.types import Ints


@dataclass(frozen=True, eq=False)
class Order:
    """An order of taxels.

    Attributes:
        order: (J,) index in the data of the taxel that belongs at each position.
        mapping: lines of a mapping file that produce it.
    """

    order: Ints
    mapping: str


def named_orders(rows: int, cols: int) -> list[Order]:
    """Return orders that have a plausible cause, that of the data first, each once.

    The array is read by rows or by columns, straight or in a serpentine, from any of its corners. Its rows or
    columns may be shifted cyclically, all or one of them; two of them may be exchanged; or the even ones come
    first, then the odd ones.
    """
    found: dict[bytes, Order] = {}

    def add(image: Ints, lines: tuple[str, ...] | None) -> None:
        order = np.ascontiguousarray(image.ravel())
        mapping = "\n".join(lines) if lines is not None else _format_order(order)
        found.setdefault(order.tobytes(), Order(order, mapping))

    flat = np.arange(rows * cols)
    straight: list[tuple[Ints, tuple[str, ...]]] = [
        (flat.reshape(rows, cols), ()),
        (flat.reshape(cols, rows).T, ("transpose = true",)),
    ]
    plain = list[tuple[Ints, tuple[str, ...] | None]]()
    for image, lines in straight:
        for flip_rows in (False, True):
            for flip_cols in (False, True):
                turned = image[:: -1 if flip_rows else 1, :: -1 if flip_cols else 1]
                extra = ("flip_rows = true",) * flip_rows + ("flip_cols = true",) * flip_cols
                plain.append((turned, (*lines, *extra)))
    for image, lines in plain:
        add(image, lines)
    wound = [
        _serpentine(image, first, by_rows)
        for image, _ in plain
        for first in (0, 1)
        for by_rows in (True, False)
    ]
    for image in wound:
        add(image, None)
    for image in [image for image, _ in plain] + wound:
        for axis, length in ((0, rows), (1, cols)):
            for shift in range(1, length):
                add(np.roll(image, shift, axis=axis), None)
    for shift in (1, -1):
        add(np.roll(flat, shift), None)
    image = flat.reshape(rows, cols)
    for axis, length in ((0, rows), (1, cols)):
        for lines in _exchange_lines(length):
            add(image.take(lines, axis=axis), None)
        for line in range(length):
            for shift in range(1, flat.size // length):
                shifted = np.moveaxis(image.copy(), axis, 0)
                shifted[line] = np.roll(shifted[line], shift)
                add(np.moveaxis(shifted, 0, axis), None)
    return list(found.values())


def _exchange_lines(length: int) -> list[Ints]:
    """Return orders of rows, or columns, with two exchanged, or read in two banks."""
    plain = np.arange(length)
    found = [np.concatenate([plain[::2], plain[1::2]]), np.concatenate([plain[1::2], plain[::2]])]
    found += [np.argsort(one) for one in found]
    for a, b in combinations(range(length), 2):
        other = plain.copy()
        other[[a, b]] = other[[b, a]]
        found.append(other)
    return found


def mapping_of(order: Ints, rows: int, cols: int) -> str:
    """Return the shortest lines of a mapping file, under ``[taxels]``, that produce an order.

    Args:
        order: (J,) index in the data of the taxel that belongs at each position.
        rows: of the layout.
        cols: of the layout.
    """
    named = (one.mapping for one in named_orders(rows, cols) if (one.order == order).all())
    return next(named, _format_order(order))


def _serpentine(image: Ints, first: int, by_rows: bool) -> Ints:
    """Return the image with every other row (or column), from ``first`` on, reversed."""
    out = image.copy()
    if by_rows:
        out[first::2] = out[first::2, ::-1]
    else:
        out[:, first::2] = out[::-1, first::2]
    return out


def _format_order(order: Ints) -> str:
    """Return an order as a line of a mapping file."""
    return f"order = [{', '.join(str(j) for j in order.tolist())}]"
