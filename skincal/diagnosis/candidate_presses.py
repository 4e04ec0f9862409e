"""Candidates for the next presses on the rig of a dataset, and the observations that they would bring."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from skincal.collect import FullProtocol, Plan, full_plan
from skincal.dataset import Dataset
from skincal.diagnosis.planned_session import Schedule, schedule_plan
from skincal.diagnosis.rig import Rig
from skincal.inference.session import GapSession
from skincal.model.arrays import as_floats

Floats = NDArray[np.float64]

_REGULAR, _REPEATS, _REVISITS, _OTHER = 44, 12, 14, 14
_REST_S = 1.0
"""Longest observed part of the rest after a press [s]."""


def plan_candidates(rig: Rig, rng: np.random.Generator) -> Plan:
    """Return the candidates: a full protocol within the limits of a rig, without a second indenter."""
    options = FullProtocol(
        regular=_REGULAR,
        repeats=_REPEATS,
        revisits=_REVISITS,
        forces_n=rig.forces_n,
        speeds_m_per_s=rig.speeds_m_per_s,
        holds_s=rig.holds_s,
        poses=rig.poses[:4],
        anchor_force_n=rig.usual.force_n,
        second_indenter=_OTHER,
    )
    plan = full_plan(rng, rig.pressed_area, options, None)
    return replace(plan, presses=tuple(rig.on_surface(plan.presses)))


def simulate_session(plan: Plan, rig: Rig, dataset: Dataset, rng: np.random.Generator) -> GapSession:
    """Return the observations that a plan would bring on the rig of a dataset.

    Ratios of tangential to normal force are drawn from those of the dataset; the temperature is its mean.

    Args:
        plan: presses in their order.
        rig: limits and timing of the rig.
        dataset: gives indenters, tangential forces and temperature.
        rng: draws the tangential forces.
    """
    radii = sorted({p.indenter_radius_m for p in plan.presses if p.indenter_radius_m is not None})
    tools = (None, *radii)
    kinds = np.array([tools.index(p.indenter_radius_m) for p in plan.presses])
    poses = np.array([rig.poses.index(p.pose) for p in plan.presses])
    indenters = tuple(dataset.indenter(radius) for radius in tools)
    session = schedule_plan(
        plan, rig.mount, (indenters, kinds), poses, _schedule(plan, rig), rig.frame_rate_hz
    )
    return replace(session, samples=replace(session.samples, **_draw_covariates(session, dataset, rng)))


def _draw_covariates(session: GapSession, dataset: Dataset, rng: np.random.Generator) -> dict[str, Floats]:
    """Return tangential forces (K, 2) [N] and temperatures (K,) [°C] of a session, where the dataset has them."""
    presses, samples, columns = dataset.presses, session.samples, dict[str, Floats]()
    shear = [presses.column(name) for name in ("shear_u_n", "shear_v_n")]
    if shear[0] is not None and shear[1] is not None:
        ratio = np.stack([shear[0], shear[1]], axis=1) / np.maximum(presses.force_n, 1e-3)[:, None]
        ratio = ratio[np.isfinite(ratio).all(axis=1)]
        if len(ratio):
            drawn = ratio[rng.integers(0, len(ratio), session.presses)][np.maximum(session.row, 0)]
            columns["shear_n"] = drawn * np.where(samples.touching, samples.contacts.force_n, 0.0)[:, None]
    temperature = presses.column("temperature_c")
    if temperature is not None and np.isfinite(temperature).any():
        columns["temperature_c"] = np.full(len(samples), float(np.nanmean(temperature)))
    return columns


def _schedule(plan: Plan, rig: Rig) -> Schedule:
    """Return the times of the presses of a plan at the pace of a rig."""
    ramp = [rig.ramp[0] + rig.ramp[1] * p.force_n / p.speed_m_per_s for p in plan.presses]
    phases_s = np.array([[0.0, r, p.hold_s, r] for r, p in zip(ramp, plan.presses, strict=True)])
    lengths_s = phases_s.sum(axis=1)
    start_s = rig.idle_s * np.arange(1, len(plan) + 1) + np.cumsum(lengths_s) - lengths_s
    times = as_floats(start_s[:, None] + np.cumsum(phases_s, axis=1))
    return Schedule(times, np.full(len(plan), min(rig.idle_s, _REST_S)))
