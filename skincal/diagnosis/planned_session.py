"""Convert a plan to the session that it would record: positions, forces, timing and number of frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skincal.collect import CollectOptions, Mount, Plan
from skincal.collect.poses import paces_s, with_poses
from skincal.collect.posture import Fingers
from skincal.dataset.dataset import indenter_of
from skincal.effects import Samples, Steps, hold_session, met_before
from skincal.effects.samples import HOLD, IDLE, LOAD, UNLOAD
from skincal.inference.session import GapSession
from skincal.model import Contacts, Indenter
from skincal.prediction.session_samples import pose_numbers
from skincal.robot import HandDescription, Kinematics

Floats = NDArray[np.float64]

STEPS = Steps(8, 6, 8)
"""Number of observations in each phase of a planned press."""


@dataclass(frozen=True, eq=False)
class Schedule:
    """Times of the presses of a plan.

    Attributes:
        times_s: (P, 4) start, hold, release and end of each press [s].
        idle_s: (P,) observed part of the rest after each press [s].
    """

    times_s: Floats
    idle_s: Floats


def plan_session(
    plan: Plan, description: HandDescription, options: CollectOptions | None = None
) -> GapSession:
    """Return the observations that a plan would bring on a hand.

    Tangential forces and temperatures are not planned, so effects that need them lack a covariate.

    Args:
        plan: presses in their order.
        description: the hand; its stiffness determines how fast forces rise.
        options: options of the collection.
    """
    options = options or CollectOptions()
    fingers = Fingers(Kinematics(description), Mount.of(description.meta))
    schedule = _schedule(with_poses(plan, fingers, options), fingers, options)
    indenter = description.meta.indenter
    radii = np.array([p.indenter_radius_m or indenter.radius_m or 0.0 for p in plan.presses])
    different, kinds = np.unique(radii, return_inverse=True)
    indenters = tuple(indenter_of(indenter, {}, float(r)) for r in different)
    names = np.array([p.pose for p in plan.presses])
    poses = pose_numbers(names, sorted(set(names.tolist())))
    return schedule_plan(plan, fingers.mount, (indenters, kinds), poses, schedule, options.frame_rate_hz)


def schedule_plan(
    plan: Plan,
    mount: Mount,
    indenters: tuple[tuple[Indenter, ...], NDArray[np.integer]],
    poses: NDArray[np.int64],
    schedule: Schedule,
    frame_rate_hz: float,
) -> GapSession:
    """Return the observations that a plan would bring at the times of a schedule.

    Args:
        plan: presses in their order.
        mount: maps sites to points on the surface.
        indenters: the indenters, and (P,) index of the one of each press.
        poses: (P,) number of the hand pose.
        schedule: times of the presses.
        frame_rate_hz: frame rate [Hz].
    """
    points, normals = mount.place(plan.sites_m())
    force, cycle = np.array([p.force_n for p in plan.presses]), np.array(plan.cycles(), dtype=np.float64)
    number = {point: k for k, point in enumerate(dict.fromkeys(p.site for p in plan.presses))}
    site = np.array([number[p.site] for p in plan.presses], dtype=np.int64)
    holds = Samples.of(
        Contacts(points, normals, force),
        (indenters[0], indenters[1].reshape(-1)),
        press=np.arange(len(plan)),
        speed_m_per_s=np.array([p.speed_m_per_s for p in plan.presses]),
        cycle=cycle,
        met_n=met_before(site, cycle, force),
        pose=poses,
    )
    played = hold_session(holds, schedule.times_s, STEPS)
    phase = played.samples.phase
    assert phase is not None
    row = np.where(phase == IDLE, -1, played.row)
    frames = frame_rate_hz * _observation_seconds(schedule)[played.row, phase]
    return GapSession(played.samples, row, np.arange(len(row)), row, phase, frames)


def _observation_seconds(schedule: Schedule) -> Floats:
    """Return the time (P, 4) [s] that one observation of each phase represents."""
    lengths = np.diff(schedule.times_s, axis=1)
    seconds = np.empty((len(lengths), 4))
    for phase, column, count in ((LOAD, 0, STEPS.load), (HOLD, 1, STEPS.hold), (UNLOAD, 2, STEPS.unload)):
        seconds[:, phase] = lengths[:, column] / count
    seconds[:, IDLE] = schedule.idle_s
    return seconds


def _schedule(plan: Plan, fingers: Fingers, options: CollectOptions) -> Schedule:
    """Return the times of the presses, by the same paces as the estimate of the session's length."""
    times, idle, now_s = np.zeros((len(plan), 4)), np.zeros(len(plan)), options.rest_s
    for k, (idle_s, ramp_s) in enumerate(paces_s(plan, fingers, options)):
        ramp_s += options.ease_s
        idle[k], times[k] = idle_s, now_s + idle_s + np.cumsum([0.0, ramp_s, plan.presses[k].hold_s, ramp_s])
        now_s = times[k, 3]
    # Only a short part of the rest after a press is observed.
    return Schedule(times, np.minimum(idle, options.idle_s + options.still_s))
