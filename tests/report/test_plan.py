"""The picture of a plan."""

from __future__ import annotations

import numpy as np

from skincal.collect import Mount, full_plan
from skincal.report.plan import plan_figure
from skincal.robot import bundled_hand


def test_speeds_are_told_by_shapes_that_a_person_knows() -> None:
    mount = Mount.of(bundled_hand().meta)
    figure = plan_figure(full_plan(np.random.default_rng(0), mount.layout), mount)
    title = figure.axes[1].get_title(loc="left") or figure.axes[1].get_title()
    assert title == "Order; circles: 16 mm/s, squares: 40 mm/s"
