"""A sensor that tares itself while it is touched is told from one that does not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from collect.fake_hand import FakeHand
from collect.test_connection import GUARD, HAND, PLAN

from skincal.collect import Collected, collect
from skincal.hand import HandState

REST = 20.0


class Sensor:
    """Rests at a level of its own; tares in the press of that number, counted by those that light it clearly."""

    def __init__(self, tares_in: int) -> None:
        self.tares_in, self.presses, self.lit = tares_in, 0, False
        self.tare = np.zeros(16)

    def __call__(self, number: int, state: HandState) -> HandState:
        lit = bool(state.taxels.max() > (40 if self.lit else 100))
        if lit and not self.lit:
            self.presses += 1
            if self.presses == self.tares_in:
                self.tare = state.taxels.copy()
        self.lit = lit
        return replace(state, taxels=np.clip(state.taxels - self.tare + REST, 0, 255))


def session(folder: Path, tares_in: int) -> Collected:
    sensor = Sensor(tares_in)
    return collect(PLAN, HAND, lambda need: FakeHand(spoil=sensor), folder / "run", guard=GUARD)


@pytest.mark.parametrize("tares_in", [0, 1])
def test_a_tare_under_load_is_reported(tmp_path: Path, tares_in: int) -> None:
    found = session(tmp_path, tares_in)
    if not tares_in:
        assert found.rest_shifts == ()
        return
    (shift,) = found.rest_shifts
    assert shift.place == "press 2"
    assert "at 20.4 counts before and 0 after" in str(shift)
    assert "only without contact" in str(shift)
