"""Conversion of ``presses.csv`` or ``.parquet`` to :class:`Presses`; every violation is reported."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from skincal.covariates import ANY, NORMAL, POSITION, TIMES
from skincal.dataset.columns import CORRECT_OR_EMPTY, NO_FORCE, OPTIONAL, ColumnReader, repeated
from skincal.dataset.count_checks import check_counts
from skincal.dataset.spec import DatasetMeta
from skincal.dataset.table_file import RawTable
from skincal.dataset.tables import Presses

REQUIRED = ("press", *POSITION, "force_n")
TWICE = "Remove the copy; if they are two presses, give each its own number."


def presses_from(table: RawTable, meta: DatasetMeta) -> Presses:
    """Return the presses of a table; add problems to the table's findings."""
    taxels = meta.sensor.taxel_columns()
    reader = ColumnReader(table)
    reader.require(REQUIRED)
    reader.require(taxels)
    reader.require_rows("at least one press", "Was the table cut short, or filtered too strictly?")
    press = reader.whole("press", "a whole number, 0 or more", 0, "Number the presses 0, 1, 2, …")
    counts = reader.matrix(taxels)
    unknown = math.isinf(meta.position.sigma_m)
    presses = Presses(
        press=press,
        position_m=reader.checked_matrix(POSITION, ANY, may_be_nan=unknown),
        force_n=reader.checked("force_n", ANY, may_be_nan=False, if_empty=NO_FORCE),
        counts=counts,
        normals=_normals(reader),
        columns=dict(
            reader.optional(
                {**OPTIONAL, **dict.fromkeys(TIMES, ANY)},
                {*REQUIRED, *NORMAL, *(taxels or reader.taxel_columns())},
            )
        ),
    )
    if reader.has("press"):  # invalid numbers have been reported
        copies = repeated(press) & (press >= 0)
        reader.sheet.bad_rows("press", copies, press, "each number once", TWICE)
    present = [j for j, name in enumerate(taxels) if reader.has(name)]
    check_counts(reader, meta.sensor, counts[:, present].T, whole=False)
    branch = presses.column("branch")
    if branch is not None:
        bad = ~np.isin(branch.astype(str), ["up", "down", ""])
        reader.sheet.bad_rows("branch", bad, branch, '"up", "down" or nothing')
    for earlier, later in pairwise(name for name in TIMES if name in presses.columns):
        before, after = presses.columns[earlier], presses.columns[later]
        reader.sheet.bad_rows(later, after < before, after, f"a time not before {earlier}", CORRECT_OR_EMPTY)
    return presses


def _normals(reader: ColumnReader) -> np.ndarray | None:
    """Return the measured normals, shape (K, 3), NaN where not measured; None without such columns."""
    present = [name for name in NORMAL if reader.has(name)]
    if not present:
        return None
    reader.require(NORMAL)
    normals = reader.checked_matrix(NORMAL, ANY)
    if len(present) == 3:
        given, names, fix = (
            np.isfinite(normals),
            ", ".join(NORMAL),
            "Give all three, or leave the cells empty.",
        )
        partial = given.any(axis=1) & ~given.all(axis=1)
        reader.sheet.bad_rows(names, partial, normals, "all three, or none", fix)
        length = np.linalg.norm(normals, axis=1)
        wrong = given.all(axis=1) & (np.abs(length - 1) > 0.01)
        reader.sheet.bad_rows(names, wrong, length, "a vector of length 1", "Divide by its length.")
    return normals
