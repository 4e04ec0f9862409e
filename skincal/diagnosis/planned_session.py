"""A plan as a session that has not been recorded: its places, forces and timing, with frames as collect takes them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skincal.collect import CollectOptions, Mount, Plan
from skincal.collect.poses import with_poses
from skincal.collect.posture import Fingers
from skincal.collect.travel import paces_s
from skincal.dataset.model_objects import indenter_of
from skincal.effects import Samples, Steps, hold_session, met_before
from skincal.effects.samples import HOLD, IDLE, LOAD, UNLOAD
from skincal.inference.session import GapSession
from skincal.model import Contacts, Indenter
from skincal.prediction.session_samples import pose_numbers
from skincal.robot import HandDescription, Kinematics

Floats = NDArray[np.float64]

STEPS = Steps(8, 6, 8)
"""Observations of each phase of a planned press."""


@dataclass(frozen=True, eq=False)
class Course:
    """Start, hold, release and end (P, 4) [s] of all presses, and the idle time observed after each (P,) [s]."""

    times_s: Floats
    idle_s: Floats


def plan_session(
    plan: Plan, description: HandDescription, options: CollectOptions | None = None
) -> GapSession:
    """The observations that a plan would bring.

    Tangential forces and temperatures are not planned, so effects that need them abstain.

    Args:
        plan: the presses, in their order.
        description: the hand; its stiffness says how fast forces rise.
        options: how presses are made.
    """
    options = options or CollectOptions()
    fingers = Fingers(Kinematics(description), Mount.of(description.meta))
    course = _course(with_poses(plan, fingers, options), fingers, options)
    indenter = description.meta.indenter
    radii = np.array([p.indenter_radius_m or indenter.radius_m or 0.0 for p in plan.presses])
    different, kinds = np.unique(radii, return_inverse=True)
    indenters = tuple(indenter_of(indenter, {}, float(r)) for r in different)
    names = np.array([p.pose for p in plan.presses])
    poses = pose_numbers(names, sorted(set(names.tolist())))
    return played_plan(plan, fingers.mount, (indenters, kinds), poses, course, options.frame_rate_hz)


def played_plan(
    plan: Plan,
    mount: Mount,
    indenters: tuple[tuple[Indenter, ...], NDArray[np.integer]],
    poses: NDArray[np.int64],
    course: Course,
    frame_rate_hz: float,
) -> GapSession:
    """The observations that a plan would bring, once it is known when each press would be.

    Args:
        plan: the presses, in their order.
        mount: where their sites lie.
        indenters: the things that press, and (P,) which of them it is.
        poses: (P,) number of the hand pose.
        course: when.
        frame_rate_hz: frames in a second [Hz].
    """
    points, normals = mount.place(plan.sites_m())
    force, cycle = np.array([p.force_n for p in plan.presses]), np.array(plan.cycles(), dtype=np.float64)
    number = {place: k for k, place in enumerate(dict.fromkeys(p.site for p in plan.presses))}
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
    played = hold_session(holds, course.times_s, STEPS)
    phase = played.samples.phase
    assert phase is not None
    row = np.where(phase == IDLE, -1, played.row)
    frames = frame_rate_hz * _seconds(course)[played.row, phase]
    return GapSession(played.samples, row, np.arange(len(row)), row, phase, frames)


def _seconds(course: Course) -> Floats:
    """Time (P, 4) [s] that each observation of a phase stands for."""
    lasts = np.diff(course.times_s, axis=1)
    seconds = np.empty((len(lasts), 4))
    for phase, length, count in ((LOAD, 0, STEPS.load), (HOLD, 1, STEPS.hold), (UNLOAD, 2, STEPS.unload)):
        seconds[:, phase] = lasts[:, length] / count
    seconds[:, IDLE] = course.idle_s
    return seconds


def _course(plan: Plan, fingers: Fingers, options: CollectOptions) -> Course:
    """When each press would be, much as the estimate of the session's length has it."""
    times, idle, now_s = np.zeros((len(plan), 4)), np.zeros(len(plan)), options.rest_s
    for k, (idle_s, ramp_s) in enumerate(paces_s(plan, fingers, options)):
        ramp_s += options.ease_s
        idle[k], times[k] = idle_s, now_s + idle_s + np.cumsum([0.0, ramp_s, plan.presses[k].hold_s, ramp_s])
        now_s = times[k, 3]
    # What is observed of the rest is a short while after a press only.
    return Course(times, np.minimum(idle, options.idle_s + options.still_s))
