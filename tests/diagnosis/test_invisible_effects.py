"""Recommendations fit the rig."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from skincal.diagnosis.invisible_effects import PressVariety, phrase_for_stage, recommend_recordings
from skincal.effects import EFFECTS


@pytest.mark.parametrize("lacking", [(), ("pose", "time")])
@pytest.mark.parametrize("lost_to_base", [0.0, 2.0])
def test_recommendations_for_a_stage_do_not_mention_hands(lacking: tuple[str, ...], lost_to_base: float):
    none = PressVariety(False, False, False, 1.0, 1, False, 1.0, 1, 0.0)
    cures: list[str] = []
    for name in EFFECTS:
        audit: Any = SimpleNamespace(name=name, lacking=lacking, raw_distance=3.0, threshold=1.0,
                                     lost_to_base=lost_to_base, lost_to_presses=1.0)  # fmt: skip
        cures += recommend_recordings(audit, none)
    assert any("hand" in cure for cure in cures)
    assert not any("hand" in phrase_for_stage(cure) for cure in cures)
