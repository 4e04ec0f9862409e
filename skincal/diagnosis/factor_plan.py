"""Plan presses that vary one factor at a time, for a residual that no known effect explains.

The factors are those that the residual depends on. Everything else stays as in a usual press. Each combination is
repeated at several sites, so that scatter and dependence can be separated.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from skincal.collect import Plan, PlannedPress
from skincal.collect.protocols import spread_sites
from skincal.diagnosis.rig import Rig

Factor = Literal["force", "pace", "time", "touches", "places", "poses", "indenters"]

FACTORS: Mapping[str, Factor] = {
    "unloading": "pace",
    "loading": "pace",
    "the hold": "pace",
    "speed": "pace",
    "low speed": "pace",
    "rest": "time",
    "begin": "time",
    "end": "time",
    "cycle": "touches",
    "low cycle": "touches",
    "force": "force",
    "small force": "force",
    "pose": "poses",
    "indenter": "indenters",
}
"""Factor to vary for each part of a session (:mod:`skincal.diagnosis.residual_location`)."""

WORDS: Mapping[Factor, str] = {
    "force": "only the force differs",
    "pace": "only the speed of loading and the length of the hold differ",
    "time": "the same few presses are repeated throughout the session",
    "touches": "each site is touched several times in a row",
    "places": "the same press is made all over the patch",
    "poses": "only the hand's pose differs",
    "indenters": "only the indenter differs",
}

PRESSES, _TOUCHES, _LEVELS = 30, 4, 5
_DEFAULT: tuple[Factor, ...] = ("force", "pace")


def choose_factors(names: Sequence[str], rig: Rig, most: int = 2) -> list[Factor]:
    """Return the factors to vary, most relevant first; force and pace if no part of the session stands out.

    Args:
        names: keys of the parts of the session with much of the residual, highest share first.
        rig: limits the factors to those that it can vary.
        most: largest number of factors.
    """
    related: list[Factor] = [FACTORS[name] for name in names if name in FACTORS]
    possible: list[Factor] = [
        f for f in related if (f != "poses" or len(rig.poses) > 1) and (f != "indenters" or rig.radii_m)
    ]
    return list(dict.fromkeys(possible))[:most] or [*_DEFAULT]


def plan_factors(factors: Sequence[Factor], rig: Rig, rng: np.random.Generator) -> Plan:
    """Return a session of presses that vary these factors one after the other, between two anchors."""
    usual = rig.usual
    sites = [replace(usual, u_m=u, v_m=v) for u, v in spread_sites(rng, rig.pressed_area, PRESSES)]
    sites = rig.on_surface(sites) or [usual]
    share = PRESSES // len(factors)
    parts = [_vary(factor, share, usual, sites, rig, rng) for factor in factors]
    # Presses that are repeated throughout the session alternate with the others.
    parts = list(itertools.zip_longest(*parts)) if "time" in factors else parts
    presses = [p for part in parts for p in part if p is not None]
    # Grouped by indenter and pose, so that the indenter is changed once and the pose rarely.
    order = sorted(presses, key=lambda p: (p.indenter_radius_m or 0.0, rig.poses.index(p.pose)))
    return rig.plan_session(order)


def _vary(
    factor: Factor,
    count: int,
    usual: PlannedPress,
    sites: Sequence[PlannedPress],
    rig: Rig,
    rng: np.random.Generator,
) -> list[PlannedPress]:
    """Return ``count`` presses that vary one factor over some of the sites, in random order where that is possible."""
    if factor == "time":
        return list(itertools.islice(itertools.cycle(sites[:3]), count))
    if factor == "touches":
        return [p for p in sites[: max(1, count // _TOUCHES)] for _ in range(_TOUCHES)]
    levels = _levels(factor, usual, rig)
    # With one level only, more sites can be visited.
    places = sites[: max(1, 2 * count // 3 if len(levels) == 1 else count // (2 * len(levels)))]
    combinations = [replace(p, u_m=at.u_m, v_m=at.v_m) for at in places for p in levels]
    chosen = list(itertools.islice(itertools.cycle(combinations), count))
    return [chosen[int(i)] for i in rng.permutation(count)]


def _levels(factor: Factor, usual: PlannedPress, rig: Rig) -> list[PlannedPress]:
    """Return the usual press with each level of a factor."""
    if factor == "force":
        low, high = (force**0.5 for force in rig.forces_n)
        roots = [low + (high - low) * i / (_LEVELS - 1) for i in range(_LEVELS)]
        return [replace(usual, force_n=round(root**2, 3)) for root in roots]
    if factor == "pace":
        both = itertools.product(rig.speeds_m_per_s, rig.holds_s)
        return [replace(usual, speed_m_per_s=speed, hold_s=hold) for speed, hold in both]
    if factor == "poses":
        return [replace(usual, pose=name) for name in rig.poses]
    if factor == "indenters":
        return [replace(usual, indenter_radius_m=radius) for radius in (None, *rig.radii_m)]
    return [usual]
