"""Sessions that the tests of the audit share: frames of a full protocol, and static presses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from effects.effect_sessions import FINGER, LAYOUT, contacts_at

from skincal.effects import Samples, Steps, hold_session, hold_times
from skincal.fit.observe import Readout
from skincal.gap.base import BaseModel
from skincal.gap.session import GapSession, binned, of_holds
from skincal.model import SensorPose, Sphere

READOUT = Readout(0, 255, integer=True)
MODEL = BaseModel(FINGER, LAYOUT, SensorPose(0.0235, 0.2, 0.05), 4e8, 70.0, READOUT, 0.8e-3)


def full(presses: int = 30, seed: int = 3, *, raster: bool = False) -> GapSession:
    """Random order, two speeds, two holds, two poses, two indenters, repeats, shear: nothing hides.

    Args:
        presses: how many.
        seed: of all chance.
        raster: sites row by row instead, one force and one pace, so that time and place are the same thing.
    """
    rng = np.random.default_rng(seed)
    sites = rng.uniform(-5e-3, 5e-3, (max(2, presses * 2 // 3), 2))
    which = np.concatenate([np.arange(len(sites)), rng.integers(0, len(sites), presses - len(sites))])
    which = rng.permutation(which)
    across, along = sites[which].T
    if raster:
        which = np.arange(presses)
        side = np.linspace(-6e-3, 6e-3, int(np.sqrt(presses)))
        along, across = (g.ravel() for g in np.meshgrid(side, side, indexing="ij"))
    cycle = [int((which[:k] == which[k]).sum()) for k in range(len(which))]
    count = len(across)
    fast = np.zeros(count, dtype=bool) if raster else rng.uniform(size=count) < 0.5
    force = np.full(count, 2.0) if raster else rng.uniform(0.4, 5.0, count)
    shear = rng.normal(0.0, 0.5, (2, count))
    holds = Samples.of(
        contacts_at(across, along, force),
        ((Sphere(0.006), Sphere(0.004)), np.zeros(count, dtype=int) if raster else rng.integers(0, 2, count)),
        press=np.arange(count),
        speed_m_per_s=np.where(fast, 2e-3, 2.5e-4),
        cycle=np.array(cycle),
        met_n=np.array([force[:k][which[:k] == which[k]].max(initial=0.0) for k in range(count)]),
        pose=np.zeros(count, dtype=int) if raster else rng.integers(0, 2, count),
        temperature_c=25 + np.cumsum(rng.normal(0.0, 0.3, count)),
        shear_u_n=shear[0],
        shear_v_n=shear[1],
    )
    start = 3.0 + 12.0 * np.arange(count)
    stay = np.where(rng.uniform(size=count) < 0.5, 1.0, 3.0)
    times = hold_times(
        count, start, start + np.where(fast, 0.3, 2.0), start + np.where(fast, 0.3, 2.0) + stay
    )
    played = hold_session(holds, times, Steps(10, 10, 10))
    row = np.where(played.samples.touching, played.row, -1)
    return binned(played.samples, row, None, FINGER)


def static(presses: int = 36, seed: int = 5, *, clock: bool = False) -> GapSession:
    """Static presses as in the paper: places, forces and hold means, nothing else."""
    rng = np.random.default_rng(seed)
    across, along = rng.uniform(-6e-3, 6e-3, (2, presses))
    holds = Samples.of(
        contacts_at(across, along, rng.uniform(1.0, 4.0, presses)), Sphere(0.006), press=np.arange(presses)
    )
    return of_holds(hold_session(holds, hold_times(presses), Steps(5, 4, 5)), None, clock=clock)


def without(session: GapSession, **covariates: object) -> GapSession:
    """The same session as if covariates had not been recorded, or been others."""
    return replace(session, samples=replace(session.samples, **covariates))
