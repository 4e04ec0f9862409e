"""Presses that could be made next with the rig that a dataset comes from, and what they would bring."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from skincal.collect import FullProtocol, Plan, full_plan
from skincal.dataset import Dataset
from skincal.diagnosis.planned_session import Course, played_plan
from skincal.diagnosis.rig import Rig
from skincal.inference.session import GapSession
from skincal.model.arrays import as_floats

Floats = NDArray[np.float64]

_REGULAR, _REPEATS, _REVISITS, _OTHER = 44, 12, 14, 14
_REST_S = 1.0
"""So much of the rest after a press is looked at, at most [s]."""


def pool_plan(rig: Rig, rng: np.random.Generator, *, caps: bool = False) -> Plan:
    """Presses to choose from: a full protocol as the rig can do it.

    Args:
        rig: what it can do.
        rng: the only source of chance.
        caps: whether there are presses with another indenter, at the end, if the rig has one.
    """
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
    plan = full_plan(rng, rig.field, options, rig.radii_m[0] if caps and rig.radii_m else None)
    return replace(plan, presses=tuple(rig.on_surface(plan.presses)))


def imagined(plan: Plan, rig: Rig, dataset: Dataset, rng: np.random.Generator) -> GapSession:
    """The observations that a plan would bring on the rig of a dataset.

    Tangential forces come as they came before, by the same part of the force; the temperature is the mean one.

    Args:
        plan: the presses, in their order.
        rig: how the dataset was pressed.
        dataset: gives indenters, tangential forces and the temperature.
        rng: draws tangential forces from those of the dataset.
    """
    different = (
        None,
        *sorted({p.indenter_radius_m for p in plan.presses if p.indenter_radius_m is not None}),
    )
    kinds = np.array([different.index(p.indenter_radius_m) for p in plan.presses])
    poses = np.array([rig.poses.index(p.pose) for p in plan.presses])
    tools = tuple(dataset.indenter(radius) for radius in different)
    session = played_plan(plan, rig.mount, (tools, kinds), poses, _course(plan, rig), rig.frame_rate_hz)
    return replace(session, samples=replace(session.samples, **_surroundings(session, dataset, rng)))


def _surroundings(session: GapSession, dataset: Dataset, rng: np.random.Generator) -> dict[str, Floats]:
    """Tangential forces (K, 2) [N] and temperatures (K,) [°C] of a session, where the dataset has them."""
    presses, samples, found = dataset.presses, session.samples, dict[str, Floats]()
    shear = [presses.column(name) for name in ("shear_u_n", "shear_v_n")]
    if shear[0] is not None and shear[1] is not None:
        share = np.stack([shear[0], shear[1]], axis=1) / np.maximum(presses.force_n, 1e-3)[:, None]
        share = share[np.isfinite(share).all(axis=1)]
        if len(share):
            drawn = share[rng.integers(0, len(share), session.presses)][np.maximum(session.row, 0)]
            found["shear_n"] = drawn * np.where(samples.touching, samples.contacts.force_n, 0.0)[:, None]
    temperature = presses.column("temperature_c")
    if temperature is not None and np.isfinite(temperature).any():
        found["temperature_c"] = np.full(len(samples), float(np.nanmean(temperature)))
    return found


def _course(plan: Plan, rig: Rig) -> Course:
    ramp = [rig.ramp[0] + rig.ramp[1] * p.force_n / p.speed_m_per_s for p in plan.presses]
    lasts = np.array([[0.0, r, p.hold_s, r] for r, p in zip(ramp, plan.presses, strict=True)])
    own = lasts.sum(axis=1)
    before = rig.idle_s * np.arange(1, len(plan) + 1) + np.cumsum(own) - own
    times = as_floats(before[:, None] + np.cumsum(lasts, axis=1))
    return Course(times, np.full(len(plan), min(rig.idle_s, _REST_S)))
