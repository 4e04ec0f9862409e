"""Adaptive collection: rounds of presses, a budget, and reasons to stop."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import pytest

from skincal.collect import Plan, PlannedPress
from skincal.diagnosis import adaptive_collection as module
from skincal.diagnosis.adaptive_collection import BUDGET, ROUND, diagnose_adaptively


@dataclass
class Named:
    """Stand-in for an effect: the attributes that a round uses."""

    consistent_with: tuple[str, ...]


@dataclass
class Verdict:
    """Stand-in for a diagnosis: the attributes that a round uses."""

    verdict: str
    effects: list[Named] = field(default_factory=list)
    next_plan: Plan | None = None


def plan(count: int = 6) -> Plan:
    """Return presses between two anchors, as a diagnosis proposes them."""
    press = PlannedPress(0.0, 0.0, 1.0, 1e-3, 1.0)
    own = [replace(press, u_m=1e-3 * (k + 1)) for k in range(count)]
    anchor = replace(press, kind="anchor")
    return Plan("next-presses", (anchor, *own, anchor))


AMBIGUOUS = Verdict("effects", [Named(("creep", "latency"))], plan())
SETTLED = Verdict("effects", [Named(("creep",))])


class Rig:
    """A rig with prepared diagnoses, which records the presses and messages."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *verdicts: Verdict) -> None:
        self.verdicts, self.plans, self.messages = list(verdicts), list[Plan](), list[str]()
        monkeypatch.setattr(module, "diagnose", lambda *_: self.verdicts.pop(0))

    def press(self, dataset: object, plan: Plan, number: int) -> object:
        assert number == len(self.plans) + 1
        self.plans.append(plan)
        return dataset

    def run(self, **options: int):
        return diagnose_adaptively(
            object(), object(), self.press, report_round=self.messages.append, **options
        )  # type: ignore[arg-type]


def test_collection_ends_with_one_name(monkeypatch: pytest.MonkeyPatch):
    rig = Rig(monkeypatch, AMBIGUOUS, AMBIGUOUS, SETTLED)
    result = rig.run()
    assert result.made == 2 * ROUND and result.rounds == 2 and not result.open
    assert "settled" in result.reason
    assert rig.messages[0] == f"round 1: {ROUND} presses, to distinguish creep from latency"
    assert rig.messages[-1] == f"round 2: with {2 * ROUND} more presses: effects, creep"


def test_rounds_have_no_anchors(monkeypatch: pytest.MonkeyPatch):
    rig = Rig(monkeypatch, AMBIGUOUS, SETTLED)
    rig.run()
    (made,) = rig.plans
    assert len(made) == ROUND and all(p.kind == "regular" and p.u_m > 0 for p in made.presses)


def test_budget_is_kept(monkeypatch: pytest.MonkeyPatch):
    rig = Rig(monkeypatch, *[AMBIGUOUS] * 10)
    result = rig.run()
    assert result.made == sum(map(len, rig.plans)) == BUDGET
    assert result.open == (("creep", "latency"),) and "cannot distinguish" in result.reason
    few = Rig(monkeypatch, *[AMBIGUOUS] * 10)
    assert few.run(budget=6).made == 6 and [len(p) for p in few.plans] == [4, 2]


@pytest.mark.parametrize(
    "verdict, reason",
    [
        (Verdict("none"), "no missing effect"),
        (Verdict("unknown", next_plan=plan()), "no known effect"),
        (replace(AMBIGUOUS, next_plan=None), "no press of this rig"),
        (SETTLED, "one name"),
    ],
)
def test_no_press_without_information(monkeypatch: pytest.MonkeyPatch, verdict: Verdict, reason: str):
    rig = Rig(monkeypatch, verdict)
    result = rig.run()
    assert result.made == 0 and not rig.plans and reason in result.reason
