"""Diagnose, make the most informative presses, and diagnose again, until every effect has one name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from skincal.calibration import Calibration
from skincal.collect import Plan
from skincal.collect.protocols import named_by_order
from skincal.dataset import Dataset
from skincal.diagnosis.diagnosis import SENTENCES, Diagnosis
from skincal.diagnosis.workflow import Reporter, diagnose
from skincal.fitting.tasks import Mapper
from skincal.inference.constants import CONSTANTS as C

BUDGET, ROUND = 12, 4
"""Largest number of presses in total and in a round; after each round the next presses are chosen anew."""

Press = Callable[[Dataset, Plan, int], Dataset]
"""Make the presses of a plan in a round (counted from 1), and return the dataset with them."""


@dataclass(frozen=True, eq=False)
class CollectionResult:
    """Outcome of a diagnosis that made further presses.

    Attributes:
        diagnosis: the last diagnosis.
        dataset: the session with all presses.
        made: number of further presses.
        rounds: number of rounds of presses.
        open: name sets of the effects that still have several names.
        reason: a sentence that says why the collection ended.
    """

    diagnosis: Diagnosis
    dataset: Dataset
    made: int
    rounds: int
    open: tuple[tuple[str, ...], ...]
    reason: str

    def summary(self) -> dict[str, Any]:
        """Return the outcome as plain values."""
        is_settled = not self.open and self.diagnosis.verdict != "unknown"
        return {"presses": self.made, "rounds": self.rounds, "settled": is_settled, "reason": self.reason}


def ambiguous_sets(diagnosis: Diagnosis) -> tuple[tuple[str, ...], ...]:
    """Return the sets of names that the presses so far cannot distinguish."""
    return tuple(e.consistent_with for e in diagnosis.effects if len(e.consistent_with) > 1)


def diagnose_adaptively(
    dataset: Dataset,
    calibration: Calibration,
    press: Press,
    seed: int = 0,
    report_stage: Reporter = lambda _: None,
    null_sessions: int = C.null_sessions,
    report_round: Reporter = lambda _: None,
    budget: int = BUDGET,
    mapper: Mapper = map,
) -> CollectionResult:
    """Diagnose and press until every effect has one name, no press would help, or the budget is spent.

    Args:
        dataset: the session so far.
        calibration: calibration of the same sensor.
        press: makes further presses.
        seed: seed of all randomness.
        report_stage: callback; gets the name of each stage as it begins.
        null_sessions: number of simulated sessions without effects.
        report_round: callback; gets the purpose of each round before it, and its outcome after it.
        budget: largest number of further presses.
        mapper: runs independent fits in parallel.

    Raises:
        InputError: the calibration is of another sensor.
        WorkError: too few presses.
    """
    made, number = 0, 0
    diagnosis = diagnose(dataset, calibration, seed, report_stage, null_sessions, ROUND, mapper)
    while (reason := _stop_reason(diagnosis, made, budget)) is None:
        assert diagnosis.next_plan is not None
        plan = _without_anchors(diagnosis.next_plan, min(ROUND, budget - made))
        number += 1
        report_round(
            f"round {number}: {len(plan)} presses, to distinguish {_list(ambiguous_sets(diagnosis))}"
        )
        dataset = press(dataset, plan, number)
        made += len(plan)
        diagnosis = diagnose(dataset, calibration, seed, report_stage, null_sessions, ROUND, mapper)
        names = "; ".join(" or ".join(e.consistent_with) for e in diagnosis.effects) or "no name"
        report_round(f"round {number}: with {made} more presses: {diagnosis.verdict}, {names}")
    return CollectionResult(diagnosis, dataset, made, number, ambiguous_sets(diagnosis), reason)


def _stop_reason(diagnosis: Diagnosis, made: int, budget: int) -> str | None:
    """Return why no further press is made, or None to go on."""
    if diagnosis.verdict == "unknown":
        return f"{SENTENCES['unknown']}: a few more presses cannot settle that"
    ambiguous = ambiguous_sets(diagnosis)
    if not ambiguous:
        return "settled: every effect has one name" if diagnosis.effects else SENTENCES["none"]
    if diagnosis.next_plan is None:
        return f"no press of this rig would distinguish {_list(ambiguous)}"
    return f"{made} presses made: cannot distinguish {_list(ambiguous)}" if made >= budget else None


def _list(sets: tuple[tuple[str, ...], ...]) -> str:
    return "; ".join(" from ".join([names[0], " and ".join(names[1:])]) for names in sets)


def _without_anchors(plan: Plan, most: int) -> Plan:
    """Return the first ``most`` presses of a plan that are not anchors."""
    own = [p for p in plan.presses if p.kind != "anchor"][:most]
    return replace(plan, presses=tuple(named_by_order(own)))
