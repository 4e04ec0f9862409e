"""Conversion of the cells of a source's table to columns of the dataset, in SI."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from skincal.imports import targets, units
from skincal.imports.mapping import Quantity
from skincal.imports.recording import Column, FloatArray
from skincal.imports.text_table import TextTable


def is_text(quantity: Quantity) -> bool:
    """Return whether the source of a column holds words or dates."""
    return targets.is_text(quantity.target) or quantity.unit.name == units.DATETIME


def quantity_values(quantity: Quantity, table: TextTable) -> Column:
    """Return a column of the dataset from the cells of a table."""
    if quantity.constant is not None:
        return constant(quantity.constant, table.rows)
    if targets.is_text(quantity.target):
        return np.array(
            [quantity.words.get(word, word) for word in table.text(quantity.sources[0])], dtype=object
        )
    parts = [quantity.si(table.numbers(name)) for name in quantity.sources]
    return parts[0] if len(parts) == 1 else length(parts)


def constant(value: float | str, rows: int) -> Column:
    """Return a column with the same value in every row."""
    return np.full(rows, value, dtype=object if isinstance(value, str) else np.float64)


def length(parts: Sequence[FloatArray]) -> FloatArray:
    """Return the length of a vector from its components, shape (rows,)."""
    return np.linalg.norm(np.column_stack(parts), axis=1)
