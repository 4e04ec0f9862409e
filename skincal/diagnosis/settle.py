"""Diagnose, press what would tell most, diagnose again, until what is missing has one name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from skincal.calibration import Calibration
from skincal.collect import Plan
from skincal.collect.protocols import named_by_order
from skincal.dataset import Dataset
from skincal.diagnosis.diagnosis import Diagnosis
from skincal.diagnosis.workflow import Heard, diagnose
from skincal.fitting.tasks import Mapper
from skincal.inference.constants import CONSTANTS as C

BUDGET, ROUND = 12, 4
"""Presses that are made at most, and in a round: after each the next are chosen anew."""

Press = Callable[[Dataset, Plan, int], Dataset]
"""Makes the presses of a plan in a round (from 1), and returns the dataset with them."""


@dataclass(frozen=True, eq=False)
class Settled:
    """What a diagnosis with further presses came to.

    Attributes:
        diagnosis: the last one.
        dataset: the session with all presses.
        made: presses that were made.
        rounds: rounds of presses.
        open: effects that still have several names.
        reason: why it ended, in words.
    """

    diagnosis: Diagnosis
    dataset: Dataset
    made: int
    rounds: int
    open: tuple[tuple[str, ...], ...]
    reason: str


def open_sets(found: Diagnosis) -> tuple[tuple[str, ...], ...]:
    """Sets of names that the presses so far do not tell apart."""
    return tuple(e.consistent_with for e in found.effects if len(e.consistent_with) > 1)


def settle(
    dataset: Dataset,
    calibration: Calibration,
    press: Press,
    seed: int = 0,
    heard: Heard = lambda _: None,
    null_sessions: int = C.null_sessions,
    progress: Heard = lambda _: None,
    budget: int = BUDGET,
    mapper: Mapper = map,
) -> Settled:
    """Diagnoses until every effect has one name, no press would tell more, or all presses have been made.

    Args:
        dataset: the session so far.
        calibration: of the same sensor.
        press: makes further presses.
        seed: of all chance.
        heard: told which stage begins.
        null_sessions: simulated sessions with nothing hidden.
        progress: progress callback; gets what each round is for, and what it came to.
        budget: presses that are made at most.
        mapper: makes fits side by side.

    Raises:
        InputError: the calibration is of another sensor.
        WorkError: too few presses.
    """
    made, number = 0, 0
    found = diagnose(dataset, calibration, seed, heard, null_sessions, ROUND, mapper)
    while (reason := _ended(found, made, budget)) is None:
        assert found.next_plan is not None
        plan = _round(found.next_plan, min(ROUND, budget - made))
        number += 1
        progress(f"round {number}: {len(plan)} presses, to tell {_words(open_sets(found))}")
        dataset = press(dataset, plan, number)
        made += len(plan)
        found = diagnose(dataset, calibration, seed, heard, null_sessions, ROUND, mapper)
        names = "; ".join(" or ".join(e.consistent_with) for e in found.effects) or "no name"
        progress(f"round {number}: with {made} more presses: {found.verdict}, {names}")
    return Settled(found, dataset, made, number, open_sets(found), reason)


def _ended(found: Diagnosis, made: int, budget: int) -> str | None:
    """Why no further press is made, if none is."""
    if found.verdict == "unknown":
        return "no known effect explains what is missing: a few presses do not settle that"
    if not open_sets(found):
        return (
            "settled: every effect has one name" if found.effects else "nothing is missing that can be shown"
        )
    if found.next_plan is None:
        return f"no press of this rig would tell {_words(open_sets(found))}"
    return f"{made} presses made: {_words(open_sets(found))} not told apart" if made >= budget else None


def _words(sets: tuple[tuple[str, ...], ...]) -> str:
    return "; ".join(" from ".join([names[0], " and ".join(names[1:])]) for names in sets)


def _round(plan: Plan, most: int) -> Plan:
    """The presses of a plan that tell, without the anchors of a session of its own."""
    own = [p for p in plan.presses if p.kind != "anchor"][:most]
    return replace(plan, presses=tuple(named_by_order(own)))
