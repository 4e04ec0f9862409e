"""Fit a dataset: all of ``skincal fit`` except the command line and the report."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from skincal.calibrate.assemble import calibration_of, make_provenance
from skincal.calibrate.checkpoint import Checkpoint, fit_key
from skincal.calibrate.data_findings import (
    findings_of_check,
    is_corrupted,
    reorder_taxels,
    search_order_task,
    with_findings_of_check,
    with_moving_rest,
    with_other_order,
)
from skincal.calibrate.problem import Method, Way, choose_way, fit_problem, search_box
from skincal.calibration import Calibration
from skincal.dataset import Dataset
from skincal.dataset.dataset import refusal
from skincal.dataset.rest import REST_IN_DOUBT, rest_in_doubt
from skincal.fitting.fit_options import FitOptions, SearchBox
from skincal.fitting.problem import FEW_PRESSES, NO_DENSITY, NO_POSITION, USED, FitError, FitProblem
from skincal.fitting.result import FitResult
from skincal.fitting.solve import MIN_PRESSES, Progress, default_steps, solve
from skincal.fitting.tasks import Mapper
from skincal.shown import Shown
from skincal.workers.processes import mapper, one_blas_thread

if TYPE_CHECKING:
    from skincal.fitting.wiring import TaxelOrder

PRESS_MORE = (
    "Press harder or nearer the taxels, so that more of them answer, or lower --active-counts or --min-active; "
    "`skincal dataset show` draws where the presses lie"
)
"""Advice if presses have too few active taxels."""
PLACE_MISSING = (
    "The place of a press is missing: on a curved surface, or with an indenter smaller than the patch, images say "
    "where the sensor is only if it is known where it was pressed. Write the contact point in x_m, y_m, z_m, from the "
    "stage or the arm that pressed; of weights laid on by hand, where they were laid (a taxel's centre, say), and in "
    "[position] sigma_m how well"
)
"""Advice if the position of presses is unknown."""


@dataclass(frozen=True, eq=False)
class Outcome(Shown):
    """A calibration, and the fit that it comes from.

    Attributes:
        calibration: the calibration.
        result: result of the fit.
        resumed: number of turns of the grid that an earlier run had evaluated.
        way: way of the fit.
    """

    calibration: Calibration
    result: FitResult
    resumed: int
    way: Way

    def __repr__(self) -> str:
        return f"<Outcome {self.calibration!r}>"


@one_blas_thread()
def calibrate(
    dataset: Dataset,
    *,
    options: FitOptions | None = None,
    box: SearchBox | None = None,
    seed: int = 0,
    workers: int | Mapper | None = None,
    scheduler: str | None = None,
    checkpoint: Path | None = None,
    command: str = "",
    method: Method = "auto",
    progress: Progress = lambda _stage, _done, _total: None,
) -> Outcome:
    """Fit the skin model to a dataset; return the calibration with its fit.

    Arguments have the same meaning as those of ``skincal.fit``; ``progress`` is called with stage, done and
    total.

    Raises:
        WorkError: the presses do not allow a fit; the message says why, and what to do.
    """
    options, box, way = options or FitOptions(), box or search_box(dataset), choose_way(dataset, method)
    problem = fit_problem(dataset, options, way)
    options = replace(options, steps=options.steps or default_steps(problem))
    sha = dataset.sha256 or ""
    kept = None if checkpoint is None else Checkpoint(checkpoint, fit_key(sha, way.method, options, box))
    slabs = {} if kept is None else kept.load()
    result, failure = None, None
    orders: list[Iterable[TaxelOrder | None]] = []
    with mapper(workers, scheduler) as spread:

        def look_for_order() -> None:
            orders.append(spread(search_order_task, [(problem, box)]))

        try:
            result = solve(
                problem,
                box,
                options,
                np.random.default_rng(seed),
                mapper=spread,
                slabs=slabs,
                store=kept,
                progress=progress,
                meanwhile=look_for_order,
            )
        except FitError as error:
            failure = error
        if not orders:
            look_for_order()
        [order] = orders[0]
    if is_corrupted(findings_of_check(dataset)):
        order = None  # no order can correct such images
    if failure is not None:
        if order is None:
            raise refusal(dataset, _explain_failure(failure, problem, dataset)) from failure
        # Images in the wrong order may fit no pose at all; reordered, they at least show what the fit
        # would be.
        mended = calibrate(
            reorder_taxels(dataset, order), options=options, box=box, seed=seed, workers=workers, scheduler=scheduler,
            command=command, method=method, progress=progress,
        )  # fmt: skip
        return replace(mended, calibration=with_other_order(mended.calibration, order, dataset))
    assert result is not None
    settings = {"method": way.method} | asdict(options) | {"box": asdict(box)}
    settings = {key: value for key, value in settings.items() if value is not None}
    provenance = make_provenance(dataset, command, seed, settings)
    calibration = with_moving_rest(calibration_of(result, dataset, provenance), dataset)
    if order is not None:
        calibration = with_other_order(calibration, order, dataset)
    calibration = with_findings_of_check(calibration, dataset)
    return Outcome(calibration, result, len(slabs), way)


def _explain_failure(error: FitError, problem: FitProblem, dataset: Dataset) -> str:
    """Return why a fit is impossible, and what to do."""
    if corrupted := [one for one in findings_of_check(dataset) if is_corrupted([one])]:
        return " ".join(f"{one.text} {one.advice}" for one in corrupted)
    text = str(error)
    said = [text if text.endswith((".", "?")) else f"{text}."]
    if len(problem) < len(problem.status):
        said.append(why_dropped(problem))
    unplaced = not np.isfinite(dataset.meta.position.sigma_m)
    if text == NO_DENSITY and not unplaced:
        said.append(
            "Are positions in the fingertip frame, in metres, and each row of one and the same press?"
        )
    elif text == NO_DENSITY or (len(problem) < MIN_PRESSES and (unplaced or NO_POSITION in problem.status)):
        said.append(f"{PLACE_MISSING}.")
        if dataset.meta.surface.kind != "plane" and dataset.meta.indenter.kind == "flat":
            said.append('If a pressure chamber pressed a flat pad, write [surface] kind = "plane"')
    elif len(problem) < MIN_PRESSES:
        more = f"Collect more presses, {2 * FEW_PRESSES} or more, spread over the patch"
        pressed = PRESS_MORE if len(problem) < len(problem.status) else more
        said.append(REST_IN_DOUBT if rest_in_doubt(dataset) else pressed)
    return " ".join(said)


def why_dropped(problem: FitProblem) -> str:
    """Return how many presses were not used, and why, in one sentence."""
    reasons = Counter(status for status in problem.status if status != USED)
    if not reasons:
        return f"All {len(problem.status)} presses were used."
    listed = "; ".join(f"{count} with {reason}" for reason, count in reasons.most_common())
    if len(problem.status) == 1:
        return f"The only press was not used: {problem.status[0]}."
    dropped = sum(reasons.values())
    return (
        f"Of {len(problem.status)} presses {dropped} {'was' if dropped == 1 else 'were'} not used: {listed}."
    )
