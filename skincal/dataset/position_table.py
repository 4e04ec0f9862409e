"""``taxels.csv``: the positions of taxels that form no grid."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from skincal.covariates import ANY, POSITIVE
from skincal.dataset.columns import ColumnReader, repeated
from skincal.dataset.keys import MILLIMETRES
from skincal.dataset.spec import SensorSpec
from skincal.dataset.table_file import RawTable
from skincal.dataset.tables import TaxelPositions
from skincal.errors import first_of

COLUMNS = ("r", "c", "u_m", "v_m", "du_m", "dv_m")
LARGEST_M = 1.0

COUNT = "Rows and columns count from 0; or correct rows and cols in dataset.toml."


def positions_from(table: RawTable, sensor: SensorSpec) -> TaxelPositions | None:
    """Return the positions of the taxels in a table, in the order of the flat index.

    Every taxel of ``rows`` x ``cols`` must occur once. Problems are added to the table's findings.
    """
    if not sensor.taxels:  # the description gives no number of taxels, which has been reported
        return None
    reader = ColumnReader(table)
    reader.require(COLUMNS)
    if not all(reader.has(name) for name in COLUMNS):
        return None
    r = reader.whole("r", f"a whole number below {sensor.rows}", low=0)
    c = reader.whole("c", f"a whole number below {sensor.cols}", low=0)
    centres = reader.checked_matrix(COLUMNS[2:4], ANY, may_be_nan=False)
    sizes = reader.checked_matrix(COLUMNS[4:], POSITIVE, may_be_nan=False)
    for name, values in zip(COLUMNS[2:], (*centres.T, *sizes.T), strict=True):
        too_large = np.abs(values) > LARGEST_M
        reader.sheet.bad_rows(name, too_large, values, f"at most {LARGEST_M:g} m", MILLIMETRES)
    reader.sheet.bad_rows("r", r >= sensor.rows, r, f"a row below [sensor] rows = {sensor.rows}", COUNT)
    reader.sheet.bad_rows("c", c >= sensor.cols, c, f"a column below [sensor] cols = {sensor.cols}", COUNT)
    if (np.minimum(r, c) < 0).any():  # the taxel cannot be identified
        return None
    flat, names = r * sensor.cols + c, sensor.taxel_columns()
    again = repeated(flat)
    # A taxel that does not exist is named by its number.
    known = [names[j] if j < len(names) else str(j) for j in flat]
    reader.sheet.bad_rows("r, c", again, known, "each taxel once", "Remove the copy.")
    missing = np.setdiff1d(np.arange(sensor.taxels), flat)
    if missing.size:
        got = f"none for {first_of((names[j] for j in missing), 6)}"
        fix = "Where the image has gaps, number the taxels in one row: rows = 1, cols = their number."
        reader.sheet.findings.error(reader.sheet.file, "a row for every taxel of rows x cols", got, fix)
    if missing.size or again.any() or len(flat) != sensor.taxels:
        return None
    order = np.argsort(flat)
    return TaxelPositions(centres[order], sizes[order])


def position_columns(sensor: SensorSpec, positions: TaxelPositions) -> dict[str, NDArray[Any]]:
    """Return the table of taxel positions, as columns to write."""
    r, c = np.divmod(np.arange(sensor.taxels), sensor.cols)
    numbers = (*positions.centres_m.T, *positions.sizes_m.T)
    return dict(zip(COLUMNS, (r, c, *numbers), strict=True))
