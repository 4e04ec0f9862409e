"""Presses that settle a diagnosis: rounds, a budget, and an end."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import pytest

from skincal.collect import Plan, PlannedPress
from skincal.diagnosis import settle as module
from skincal.diagnosis.settle import BUDGET, ROUND, settle


@dataclass
class Named:
    """An effect, as far as a round looks at it."""

    consistent_with: tuple[str, ...]


@dataclass
class Verdict:
    """A diagnosis, as far as a round looks at it."""

    verdict: str
    effects: list[Named] = field(default_factory=list)
    next_plan: Plan | None = None


def plan(count: int = 6) -> Plan:
    """Presses between two anchors, as a diagnosis proposes them."""
    press = PlannedPress(0.0, 0.0, 1.0, 1e-3, 1.0)
    own = [replace(press, u_m=1e-3 * (k + 1)) for k in range(count)]
    anchor = replace(press, kind="anchor")
    return Plan("next-presses", (anchor, *own, anchor))


OPEN = Verdict("effects", [Named(("creep", "latency"))], plan())
TOLD = Verdict("effects", [Named(("creep",))])


class Rig:
    """Diagnoses in a row, and the presses that were asked for."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *verdicts: Verdict) -> None:
        self.left, self.asked, self.said = list(verdicts), list[Plan](), list[str]()
        monkeypatch.setattr(module, "diagnose", lambda *_: self.left.pop(0))

    def press(self, dataset: object, asked: Plan, number: int) -> object:
        assert number == len(self.asked) + 1
        self.asked.append(asked)
        return dataset

    def run(self, **more: int):
        return settle(object(), object(), self.press, progress=self.said.append, **more)  # type: ignore[arg-type]


def test_it_ends_when_there_is_one_name(monkeypatch: pytest.MonkeyPatch):
    rig = Rig(monkeypatch, OPEN, OPEN, TOLD)
    found = rig.run()
    assert found.made == 2 * ROUND and found.rounds == 2 and not found.open
    assert "settled" in found.reason
    assert rig.said[0] == f"round 1: {ROUND} presses, to tell creep from latency"
    assert rig.said[-1] == f"round 2: with {2 * ROUND} more presses: effects, creep"


def test_anchors_are_no_presses_that_tell(monkeypatch: pytest.MonkeyPatch):
    rig = Rig(monkeypatch, OPEN, TOLD)
    rig.run()
    (asked,) = rig.asked
    assert len(asked) == ROUND and all(p.kind == "regular" and p.u_m > 0 for p in asked.presses)


def test_the_budget_holds(monkeypatch: pytest.MonkeyPatch):
    rig = Rig(monkeypatch, *[OPEN] * 10)
    found = rig.run()
    assert found.made == sum(map(len, rig.asked)) == BUDGET
    assert found.open == (("creep", "latency"),) and "not told apart" in found.reason
    few = Rig(monkeypatch, *[OPEN] * 10)
    assert few.run(budget=6).made == 6 and [len(p) for p in few.asked] == [4, 2]


@pytest.mark.parametrize(
    "verdict, reason",
    [
        (Verdict("none"), "nothing is missing"),
        (Verdict("unknown", next_plan=plan()), "no known effect"),
        (replace(OPEN, next_plan=None), "no press of this rig"),
        (TOLD, "one name"),
    ],
)
def test_nothing_is_pressed_where_nothing_would_be_told(
    monkeypatch: pytest.MonkeyPatch, verdict: Verdict, reason: str
):
    rig = Rig(monkeypatch, verdict)
    found = rig.run()
    assert found.made == 0 and not rig.asked and reason in found.reason
