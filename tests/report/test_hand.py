"""The picture of a plan."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from skincal.collect import Mount, full_plan
from skincal.report.hand import plan_figure
from skincal.report.style import png_bytes
from skincal.robot import bundled_hand


@pytest.mark.parametrize("name", ["手势 一", "$x^{$", "🙂"])
def test_poses_may_have_any_name(name: str) -> None:
    mount = Mount.of(bundled_hand().meta)
    plan = full_plan(np.random.default_rng(0), mount.layout)
    names = {pose: f"{name}{i}" for i, pose in enumerate(plan.pose_names)}
    assert len(names) > 1
    named = replace(plan, presses=tuple(replace(press, pose=names[press.pose]) for press in plan.presses))
    # Warnings are errors here; a font that lacks a letter would warn, and a formula that does not end would raise.
    assert png_bytes(plan_figure(named, mount)).startswith(b"\x89PNG")


def test_speeds_have_named_shapes() -> None:
    mount = Mount.of(bundled_hand().meta)
    figure = plan_figure(full_plan(np.random.default_rng(0), mount.layout), mount)
    title = figure.axes[1].get_title(loc="left") or figure.axes[1].get_title()
    assert title == "Order; circles: 16 mm/s, squares: 40 mm/s"
