"""Findings about taxels that stand in another order than the data say."""

from __future__ import annotations

from dataclasses import replace

from skincal.calibrate.problem import fit_problem, search_box
from skincal.calibrate.way import choose_way
from skincal.calibration import Calibration, Finding
from skincal.dataset import Dataset
from skincal.dataset.uniform_pressure import uniform_pressure
from skincal.errors import WorkError
from skincal.fitting.fit_options import FitOptions
from skincal.fitting.wiring import TaxelOrder, order_of_problem
from skincal.model import TaxelLayout

MOST_NAMED = 8
"""So many moved taxels are named."""

_FROM_WRONG_IMAGES = (
    "dead_taxel",
    "misfit",
    "force_scatter",
    "positions_worse",
    "positions_bent",
    "glitches",
)
"""Findings that images in the wrong order bring about."""


def order_finding(order: TaxelOrder, layout: TaxelLayout) -> Finding:
    """Return the finding ``taxel_order``, with the line of a mapping file that mends it."""
    moved = ["({}, {})".format(*divmod(j, layout.cols)) for j in order.moved.tolist()]
    which = ", ".join(moved[:MOST_NAMED]) + (
        f" and {len(moved) - MOST_NAMED} more" if moved[MOST_NAMED:] else ""
    )
    lines = order.mapping.replace("\n", ", ")
    return Finding(
        "taxel_order",
        "warning",
        f"The taxels seem to stand in another order than the data say: with `{lines}` the images differ by "
        f"{order.rms_after:.3g} instead of {order.rms_before:.3g} from contacts at the measured places. "
        f"Other taxels belong at {which}.",
        f"Write `{lines}` under [taxels] of the mapping and import again, or exchange the wires. Do not use this "
        "calibration: no interval is given.",
        order.mapping,
    )


def find_taxel_order(dataset: Dataset) -> Finding | None:
    """Return the finding ``taxel_order`` if another order of its taxels explains the images of a dataset; else None.

    Uniform pressure says nothing of the order, and neither do presses that no fit can use.
    """
    if uniform_pressure(dataset):
        return None
    try:
        problem = fit_problem(dataset, FitOptions(), choose_way(dataset, "auto"))
        order = order_of_problem(problem, search_box(dataset))
    except WorkError:
        return None
    return None if order is None else order_finding(order, dataset.layout())


def in_order(dataset: Dataset, order: TaxelOrder) -> Dataset:
    """Return the dataset with its taxels in the order that explains the images; without frames."""
    presses = replace(dataset.presses, counts=dataset.presses.counts[:, order.order])
    return replace(dataset, presses=presses, frames=None)


def with_other_order(calibration: Calibration, order: TaxelOrder) -> Calibration:
    """Return the calibration with the finding, and without intervals: it comes from images in the wrong order."""
    nothing = (float("-inf"), float("inf"))
    others = (one for one in calibration.findings if one.code not in _FROM_WRONG_IMAGES)
    return replace(
        calibration,
        intervals=dict.fromkeys(calibration.intervals, nothing),
        findings=(order_finding(order, calibration.layout()), *others),
    )
