"""Estimate of a plan's duration, before anything moves."""

from __future__ import annotations

import numpy as np

from skincal.collect.plan import Plan
from skincal.collect.poses import heights, radius_of
from skincal.collect.posture import Fingers
from skincal.collect.press import FAST
from skincal.collect.press_options import CollectOptions
from skincal.collect.travel import PEAK

POSE_S = 1.0
"""Approximate time of a change of the pose [s]."""


def duration_s(plan: Plan, fingers: Fingers, options: CollectOptions) -> float:
    """Return an estimate of a session's length on the hand's clock [s], accurate to about a tenth."""
    stiffness = {
        name: fingers.posture(
            plan.presses[0].site, np.array(angles), radius_of(fingers), heights(options)
        ).stiffness_n_per_m
        for name, angles in plan.poses.items()
    }
    total, before = 2 * (options.rest_s + POSE_S), None
    for press in plan.presses:
        rate = stiffness[press.pose] * press.speed_m_per_s
        slow = min(options.approach_m_per_s, options.touch_n_per_s / stiffness[press.pose])
        way = 0.0 if before is None else float(np.hypot(*np.subtract(press.site, before.site)))
        total += PEAK * way / options.travel_m_per_s + 2 * options.still_s + options.idle_s
        total += options.before_contact_m / slow + 2 * options.clearance_m / (FAST * options.approach_m_per_s)
        total += 2 * press.force_n / rate + 3 * options.ease_s + options.reach_s / 4 + press.hold_s
        total += POSE_S if before is not None and before.pose != press.pose else 0.0
        before = press
    return total
