"""A plan on a hand: poses in which the indenter reaches every site with a reserve, and how long the presses take."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from skincal.collect.connection import PEAK
from skincal.collect.plan import CollectOptions, Plan, PlannedPress
from skincal.collect.posture import Fingers, Posture
from skincal.collect.press import FAST
from skincal.errors import InputError, Problem, WorkError
from skincal.model.arrays import FloatArray

TRIED = 120
"""Number of poses that are tried, spread evenly over the joints' ranges."""

MARGIN_RAD = 0.12
"""Distance that commanded angles of a press keep from the joint limits, for errors of the hand [rad]."""

ENOUGH_RAD = 0.2
"""Margin beyond which poses are equally good; among these the most different one is chosen."""

PLAN_MARGIN_RAD = 0.02
"""The same margin for plans that give their poses [rad]."""


@dataclass(frozen=True, eq=False)
class Reach:
    """Quality of a pose: how much reserve its presses leave.

    Attributes:
        margin_rad: smallest distance of a commanded angle from its limits [rad].
        torque_share: largest torque relative to the joint's limit.
    """

    margin_rad: float
    torque_share: float


def with_poses(plan: Plan, fingers: Fingers, options: CollectOptions) -> Plan:
    """Return the plan with angles for all its poses.

    Raises:
        InputError: angles of the plan do not fit the hand, or a press is out of reach.
        WorkError: the hand has too few poses in which all sites can be pressed.
    """
    if not plan.poses:
        poses = find_poses(plan, fingers, options)
        plan = replace(plan, poses=dict(zip(plan.pose_names, poses, strict=True)))
    check_reach(plan, fingers, options)
    return plan


def find_poses(plan: Plan, fingers: Fingers, options: CollectOptions) -> list[tuple[float, ...]]:
    """Return as many poses as the plan has, for the sites at the border of its field and its largest force.

    The first is the pose with the largest reserve. Each further one is the most different from those before it, among
    poses with enough reserve.

    Raises:
        WorkError: there are too few poses.
    """
    hand = fingers.kinematics.description
    columns = fingers.kinematics.skin.columns
    low, high = hand.limits.lower_rad[columns], hand.limits.upper_rad[columns]
    sites = _corners(plan.sites_m())
    from scipy.stats.qmc import Halton  # takes a second to import

    tried: list[tuple[float, FloatArray]] = []
    for share in Halton(len(columns), scramble=False).random(TRIED):
        skin = low + (0.1 + 0.8 * share) * (high - low)
        reach = _reach(fingers, sites, skin, plan, options)
        if reach is not None and reach.margin_rad > MARGIN_RAD and reach.torque_share < options.reserve:
            tried.append((reach.margin_rad, skin))
    wanted = len(plan.pose_names)
    if len(tried) < wanted:
        raise WorkError(
            f"hand poses: expected {wanted} in which every site of the plan can be pressed with "
            f"{plan.largest_force_n:g} N; found {len(tried)}. Give a plan with fewer poses, less force or a smaller "
            "field, or give your own poses in a plan file ([poses])."
        )
    chosen = [max(tried, key=lambda item: item[0])[1]]
    while len(chosen) < wanted:
        apart = [
            min(margin, ENOUGH_RAD) / ENOUGH_RAD * min(float(np.abs(skin - other).sum()) for other in chosen)
            for margin, skin in tried
        ]
        chosen.append(tried[int(np.argmax(apart))][1])
    return [tuple(round(float(a), 4) for a in skin) for skin in chosen]


def check_reach(plan: Plan, fingers: Fingers, options: CollectOptions) -> None:
    """Check that every press of a plan can be made, before anything moves.

    Raises:
        InputError: some presses cannot be made; all are reported.
    """
    joints = len(fingers.kinematics.skin.columns)
    problems = [
        Problem(f"plan, pose {name}", f"{joints} angles [rad], of the finger with the skin", f"{len(angles)}")
        for name, angles in plan.poses.items()
        if len(angles) != joints
    ]
    for number, press in enumerate(plan.presses) if not problems else ():
        at = f"u {1e3 * press.u_m:g} mm, v {1e3 * press.v_m:g} mm, pose {press.pose}"
        problems += _press_problems(f"plan {plan.name}, press {number} ({at})", press, plan, fingers, options)
    if problems:
        raise InputError(problems)


def _press_problems(
    where: str, press: PlannedPress, plan: Plan, fingers: Fingers, options: CollectOptions
) -> list[Problem]:
    points, _ = fingers.mount.place([press.site])
    if not np.isfinite(points).all():
        return [Problem(where, "a site on the surface", "one beyond its edge")]
    try:
        posture = fingers.posture(press.site, plan.poses[press.pose], options, press.indenter_radius_m)
    except WorkError as error:
        return [Problem(where, "a site within reach", str(error))]
    reach = reach_of(fingers, posture, press.force_n)
    problems: list[Problem] = []
    if reach.margin_rad < PLAN_MARGIN_RAD:
        got = f"a commanded angle {reach.margin_rad:.3g} rad from its limit, or beyond it"
        problems.append(Problem(where, f"joints {PLAN_MARGIN_RAD} rad within their limits", got))
    if reach.torque_share > 1:
        got = f"{press.force_n:g} N, {reach.torque_share:.3g} times what a joint may exert"
        problems.append(Problem(where, "a force within the torque limits", got))
    limit = options.reserve * fingers.kinematics.description.max_force_n
    if press.force_n > limit:
        expected = f"a force of at most {limit:g} N (hand's max_force_n)"
        problems.append(Problem(where, expected, f"{press.force_n:g} N"))
    return problems


def reach_of(fingers: Fingers, posture: Posture, force_n: float) -> Reach:
    """Return the reserve of a posture for a force."""
    limits = fingers.kinematics.description.limits
    pressed = posture.links_rad[:-1] + force_n * posture.give_rad[:, 0]
    commands = np.concatenate([posture.links_rad, pressed])
    room = np.minimum(commands - limits.lower_rad, limits.upper_rad - commands)
    return Reach(float(room.min()), float(np.max(np.abs(force_n * posture.torque_m) / limits.torque_nm)))


def _reach(
    fingers: Fingers,
    sites: Sequence[tuple[float, float]],
    skin: FloatArray,
    plan: Plan,
    options: CollectOptions,
) -> Reach | None:
    """Return the smallest reserve over some sites; None if one is out of reach or has too little reserve."""
    margin, share = np.inf, 0.0
    for site in sites:
        try:
            posture = fingers.posture(site, skin, options)
        except WorkError:
            return None
        reach = reach_of(fingers, posture, plan.largest_force_n)
        margin, share = min(margin, reach.margin_rad), max(share, reach.torque_share)
        if margin < MARGIN_RAD:
            return None
    return Reach(margin, share)


def _corners(sites_m: FloatArray) -> list[tuple[float, float]]:
    """Return the corners of the sites' field, the middles of its sides, and its middle."""
    low, high = sites_m.min(axis=0), sites_m.max(axis=0)
    shares = [(0.5, 0.5), *itertools.product((0.0, 1.0), repeat=2), (0, 0.5), (1, 0.5), (0.5, 0), (0.5, 1)]
    return [(u_m, v_m) for u_m, v_m in (low + np.array(shares) * (high - low)).tolist()]


POSE_S = 1.0
"""Approximate time of a change of the pose [s]."""


def paces_s(plan: Plan, fingers: Fingers, options: CollectOptions) -> Iterator[tuple[float, float]]:
    """Yield estimates of the time from the press before to the contact, and of a ramp of the force, of each press [s].

    Changes of the pose are left out.
    """
    first, before = plan.presses[0], plan.presses[0]
    postures = {name: fingers.posture(first.site, angles, options) for name, angles in plan.poses.items()}
    stiffness = {name: posture.stiffness_n_per_m for name, posture in postures.items()}
    fast = FAST * options.approach_m_per_s
    for press in plan.presses:
        slow = min(options.approach_m_per_s, options.touch_n_per_s / stiffness[press.pose])
        way = float(np.hypot(*np.subtract(press.site, before.site)))
        idle_s = PEAK * way / options.travel_m_per_s + 2 * options.still_s + options.idle_s
        idle_s += options.before_contact_m / slow + 2 * options.clearance_m / fast
        yield idle_s, press.force_n / (stiffness[press.pose] * press.speed_m_per_s)
        before = press


def duration_s(plan: Plan, fingers: Fingers, options: CollectOptions) -> float:
    """Return an estimate of a session's length on the hand's clock [s], accurate to about a tenth."""
    poses = [press.pose for press in plan.presses]
    changes = sum(pose != before for before, pose in itertools.pairwise(poses))
    total = 2 * (options.rest_s + POSE_S) + POSE_S * changes
    for press, (idle_s, ramp_s) in zip(plan.presses, paces_s(plan, fingers, options), strict=True):
        total += idle_s + 2 * ramp_s + 3 * options.ease_s + options.reach_s / 4 + press.hold_s
    return total
