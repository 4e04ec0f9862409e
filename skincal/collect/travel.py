"""Free motion: between sites at a height above the skin, between poses, from and to home; a plan's duration."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from skincal.collect.plan import Plan
from skincal.collect.posture import Fingers
from skincal.collect.press import FAST
from skincal.collect.press_options import CollectOptions
from skincal.collect.senses import Loop
from skincal.errors import WorkError
from skincal.model.arrays import FloatArray
from skincal.robot import contact_from_joints, place_indenter

WAYPOINT_M = 0.002
"""Spacing of the solved points of a path; between them joints move evenly [m]."""

CHECKED = 60
"""Number of points of a joint-space path that are checked for contact."""

LOWEST_SHARE = 0.5
"""Part of the travelling height below which a joint-space path must not go."""

PEAK = 1.875
"""Ratio of the largest to the mean speed of a smooth motion."""


@dataclass(frozen=True, eq=False)
class Place:
    """Position of the indenter over the skin, at travelling height.

    Attributes:
        site: patch coordinates [m].
        skin_rad: angles of the finger with the skin [rad].
        links_rad: angles of all links (n,) [rad].
    """

    site: tuple[float, float]
    skin_rad: FloatArray
    links_rad: FloatArray


def way_over_skin(
    fingers: Fingers, start: Place, site: tuple[float, float], skin_rad: FloatArray, centre_height_m: float
) -> FloatArray:
    """Return angles of the links (W, n) [rad] on the way between two sites at one height; nothing is dragged.

    Raises:
        WorkError: the path leads out of reach.
    """
    length = float(np.hypot(site[0] - start.site[0], site[1] - start.site[1]))
    turn = float(np.abs(skin_rad - start.skin_rad).max())
    count = 2 + int(max(length / WAYPOINT_M, turn / 0.05))
    shares = np.linspace(0.0, 1.0, count)[1:, None]
    sites = (1 - shares) * np.asarray(start.site) + shares * np.asarray(site)
    skins = (1 - shares) * start.skin_rad + shares * skin_rad
    points, normals = fingers.mount.place(sites)
    q = start.links_rad
    way = [q]
    for skin, centre in zip(skins, points + centre_height_m * normals, strict=True):
        q = q.copy()
        q[fingers.kinematics.skin.columns] = skin
        q = place_indenter(fingers.kinematics, centre, q)
        way.append(q)
    return np.array(way)


def way_through_joints(
    fingers: Fingers, start_rad: FloatArray, end_rad: FloatArray, radius_m: float, least_m: float
) -> FloatArray:
    """Return a straight path (W, n) [rad] of the joints if the indenter stays off the skin; else one that first rises.

    Raises:
        WorkError: both paths lead through the finger.
    """
    indenter = fingers.kinematics.indenter.columns
    first = start_rad.copy()
    first[indenter] = fingers.kinematics.description.home_rad[indenter]
    last = end_rad.copy()
    last[indenter] = first[indenter]
    for between in ([], [first], [last], [first, last]):
        way = np.stack([start_rad, *between, end_rad])
        dense = _spaced(way, np.linspace(0, len(way) - 1, CHECKED))
        if _least_height(fingers, dense, radius_m) >= least_m:
            return way
    raise WorkError(
        "free motion: expected a path from the hand's present angles to the first site on which the indenter stays "
        f"{1e3 * least_m:.1f} mm off the skin; found none. Move the fingers apart, to the hand's home angles, and run "
        "again."
    )


def _least_height(fingers: Fingers, links_rad: FloatArray, radius_m: float) -> float:
    torques = np.zeros_like(links_rad)
    contact = contact_from_joints(fingers.kinematics, links_rad, torques, indenter_radius_m=radius_m)
    return float(contact.gap_m.min())


def follow(
    loop: Loop, way_rad: FloatArray, offset_rad: FloatArray, options: CollectOptions, length_m: float = 0.0
) -> None:
    """Move along a path, slowly at both ends, while an offset of the commanded angles fades out."""
    turn = float(np.abs(np.diff(way_rad, axis=0)).max(axis=1).sum())
    time_s = PEAK * max(turn / options.travel_rad_per_s, length_m / options.travel_m_per_s)
    steps = loop.steps(time_s)
    t = np.arange(1, steps + 1) / steps
    smooth = t**3 * (10 - 15 * t + 6 * t**2)
    for share, links in zip(smooth, _spaced(way_rad, smooth * (len(way_rad) - 1)), strict=True):
        loop.step(links + (1 - share) * offset_rad)


def _spaced(way_rad: FloatArray, places: FloatArray) -> FloatArray:
    """Return the angles at positions along a path, counted in waypoints."""
    low = np.minimum(places.astype(int), len(way_rad) - 2)
    share = (places - low)[:, None]
    return (1 - share) * way_rad[low] + share * way_rad[low + 1]


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
    changes = sum(pose != before for before, pose in pairwise(poses))
    total = 2 * (options.rest_s + POSE_S) + POSE_S * changes
    for press, (idle_s, ramp_s) in zip(plan.presses, paces_s(plan, fingers, options), strict=True):
        total += idle_s + 2 * ramp_s + 3 * options.ease_s + options.reach_s / 4 + press.hold_s
    return total
