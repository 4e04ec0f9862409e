"""Findings about the data of a fit: order of the taxels, moving rest level, and advice for the rig."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from skincal.calibrate.problem import choose_way, fit_problem, search_box
from skincal.calibration import Calibration, Finding
from skincal.calibration.parts import code_of
from skincal.dataset import Dataset, rest_levels
from skincal.dataset.corrections import WRONG_WORDS
from skincal.dataset.rest import rest_drift
from skincal.dataset.uniform_pressure import uniform_pressure
from skincal.errors import WorkError
from skincal.fitting.fit_options import FitOptions, SearchBox
from skincal.fitting.problem import FitProblem
from skincal.fitting.result import OPEN
from skincal.fitting.tasks import Mapper

if TYPE_CHECKING:
    from skincal.fitting.wiring import TaxelOrder


def order_finding(order: TaxelOrder, dataset: Dataset) -> Finding:
    """Return the finding ``taxel_order``, with the line of a mapping file that corrects the order.

    It contains the order that the mapping already has.
    """
    layout, wiring, mapping = dataset.layout(), dataset.meta.wiring, order.mapping
    if wiring is not None:
        from skincal.fitting.wiring_orders import mapping_of

        mapping = mapping_of(np.array(wiring, dtype=np.intp)[order.order], layout.rows, layout.cols)
    lines = mapping.replace("\n", ", ") or "none of these keys"
    write = f"Write `{lines}` under [taxels] of the mapping"
    if wiring is not None:
        write = f"Under [taxels] of the mapping, have `{lines}` in place of order, transpose, flip_rows, flip_cols"
    if not mapping:
        write = "Remove order, transpose, flip_rows, flip_cols from [taxels] of the mapping"
    return Finding(
        "taxel_order",
        "warning",
        f"The taxels seem to stand in another order than the data say: with `{lines}` the images differ by "
        f"{order.rms_after:.3g} instead of {order.rms_before:.3g} from contacts at the measured places. "
        f"Other taxels belong at {layout.names(order.moved)}.",
        f"{write} and import again, or exchange the wires. Do not use this calibration: no interval is given.",
        mapping,
    )


def search_for_order(dataset: Dataset, mapper: Mapper = map) -> Callable[[], Finding | None]:
    """Start the search for an order of the taxels that explains the images of a dataset better.

    There is nothing to search under uniform pressure, with corrupted values, or if no fit can use the presses.

    Args:
        dataset: the session.
        mapper: one with several processes searches in the background.

    Returns:
        A function that waits for the result: the finding ``taxel_order``, or None.
    """
    found = iter(mapper(_find_order, [dataset]))

    def wait() -> Finding | None:
        order = next(found)
        return None if order is None else order_finding(order, dataset)

    return wait


def _find_order(dataset: Dataset) -> TaxelOrder | None:
    if uniform_pressure(dataset) or is_corrupted(findings_of_check(dataset)):
        return None
    try:
        problem = fit_problem(dataset, FitOptions(), choose_way(dataset, "auto"))
    except WorkError:
        return None
    return search_order_task((problem, search_box(dataset)))


def search_order_task(asked: tuple[FitProblem, SearchBox]) -> TaxelOrder | None:
    """Run :func:`skincal.fitting.wiring.find_taxel_order` with one argument, for a mapper."""
    from skincal.fitting.wiring import find_taxel_order  # slow to import

    return find_taxel_order(*asked)


def reorder_taxels(dataset: Dataset, order: TaxelOrder) -> Dataset:
    """Return the dataset with its taxels in the given order; without frames."""
    presses = replace(dataset.presses, counts=dataset.presses.counts[:, order.order])
    return replace(dataset, presses=presses, frames=None)


def findings_of_check(dataset: Dataset) -> tuple[Finding, ...]:
    """Return the warnings of a dataset's own check that have a code, as findings."""
    return tuple(
        Finding(
            p.code,
            "warning",
            f"{p.place}: expected {p.expected}; got {p.got}.",
            p.fix,
            str(p.details.get("mapping", "")),
            p.details.get("factor"),
        )
        for p in dataset.warnings
        if p.code and p.severity == "warning"
    )


def is_corrupted(findings: Iterable[Finding]) -> bool:
    """Return whether findings say that taxel values are not what the sensor measured."""
    return any(one.code in WRONG_WORDS for one in findings)


def with_findings_of_check(calibration: Calibration, dataset: Dataset) -> Calibration:
    """Return the calibration with the findings of its dataset's check; without intervals if values are corrupted."""
    found = findings_of_check(dataset)
    if is_corrupted(found):
        calibration = _without_intervals(calibration)
    return replace(calibration, findings=(*found, *calibration.findings))


def _without_intervals(calibration: Calibration) -> Calibration:
    """Return a calibration from wrong images without intervals, and without the findings that such images cause."""
    others = tuple(one for one in calibration.findings if not code_of(one.code).of_images)
    return replace(calibration, intervals=dict.fromkeys(calibration.intervals, OPEN), findings=others)


def with_other_order(calibration: Calibration, order: TaxelOrder, dataset: Dataset) -> Calibration:
    """Return the calibration with the finding of a wrong order, and without intervals."""
    calibration = _without_intervals(calibration)
    return replace(calibration, findings=(order_finding(order, dataset), *calibration.findings))


REST_MOVES: Final = "rest_moves"
"""Code of the finding on a moving rest level."""

_REST_PART: Final = 0.005
"""Movement of the rest level from which it is reported, as a fraction of the largest signal."""


def with_moving_rest(calibration: Calibration, dataset: Dataset) -> Calibration:
    """Return the calibration with a finding if the rest level moves noticeably."""
    shifts = rest_drift(dataset)
    if shifts is None or not shifts.any():
        return calibration
    size = float(np.median(np.sqrt((shifts**2).mean(axis=0))))
    if not size > _REST_PART * np.nanmax(dataset.presses.counts - rest_levels(dataset)):
        return calibration
    sensor = dataset.meta.sensor
    finding = Finding(
        REST_MOVES,
        "info",
        f"The level at rest moves by {size:.3g} {sensor.unit or 'counts'} rms between presses: drift, perhaps with "
        "re-zeroing. Each press was fitted above the level right before it.",
        "Ranges do not contain this drift; `skincal diagnose` looks for a steady one (baseline_drift).",
    )
    return replace(calibration, findings=(*calibration.findings, finding))


def has_joints(dataset: Dataset) -> bool:
    """Return whether the data are from a hand: they have joint angles or torques."""
    return any(dataset.presses.column(name) is not None for name in ("q_0", "tau_0"))


def adapt_to_rig(findings: tuple[Finding, ...], dataset: Dataset) -> tuple[Finding, ...]:
    """Return findings in the unit of the sensor, with advice for the kind of rig that a dataset is from."""
    findings = tuple(one.in_unit(dataset.meta.sensor.unit) for one in findings)
    if has_joints(dataset):
        return findings
    return tuple(replace(one, advice=code_of(one.code).on_a_stage or one.advice) for one in findings)
