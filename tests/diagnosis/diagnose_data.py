"""Datasets for the tests of the diagnosis: simulated presses with frames and covariates, and static presses."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
from effects.effect_sessions import BASE, contacts_at
from published import META

from skincal.dataset import HOLD, Dataset, Frames, Presses
from skincal.effects import Samples, Steps, hold_session, hold_times
from skincal.model import Sphere


@cache
def moving(presses: int = 16, seed: int = 2) -> Dataset:
    """Return presses with frames and covariates; every fourth is an exact repeat of the first."""
    rng = np.random.default_rng(seed)
    across, along = rng.uniform(-5e-3, 5e-3, (2, presses))
    force, speed = rng.uniform(0.8, 4.0, presses), rng.choice([2.5e-4, 2e-3], presses)
    for column in (across, along, force, speed):
        column[::4] = column[0]
    cycle = [k // 4 if k % 4 == 0 else 0 for k in range(presses)]
    contacts = contacts_at(across, along, force)
    pose = np.where(np.arange(presses) % 4 == 0, 0, rng.integers(0, 2, presses))
    holds = Samples.of(
        contacts, Sphere(0.006), press=np.arange(presses) + 100, speed_m_per_s=speed, cycle=cycle
    )
    start = 2.0 + 8.0 * np.arange(presses)
    ramp = np.where(speed > 1e-3, 0.3, 1.5)
    times = hold_times(presses, start, start + ramp, start + ramp + rng.choice([1.0, 2.0], presses))
    played = hold_session(holds, times, Steps(9, 12, 9))
    samples = played.samples
    counts = np.clip(np.round(BASE.values(samples) + rng.normal(size=(len(samples), 16))), 0, 255)
    idle = ~samples.touching
    columns = {
        "pose": np.array(["A", "B"])[pose],
        "cycle": np.array(cycle, dtype=float),
        "speed_m_per_s": speed,
    }
    targets = dict(zip(("target_x_m", "target_y_m", "target_z_m"), contacts.points_m.T, strict=True))
    clock = dict(zip(("t_start_s", "t_hold_s", "t_release_s", "t_end_s"), times.T, strict=True))
    table = Presses(
        np.arange(presses) + 100, contacts.points_m, force, counts[played.hold].mean(axis=1),
        columns={**columns, **targets, "target_force_n": force, **clock},
    )  # fmt: skip
    place = np.where(idle[:, None], np.nan, samples.contacts.points_m)
    frames = Frames(
        np.where(idle, -1, samples.press), samples.phase.astype(np.int8), samples.time_s,
        np.where(idle, 0.0, samples.contacts.force_n), place, counts,
    )  # fmt: skip
    return Dataset(META, table, frames)


def reading(given: Dataset, counts: np.ndarray, **sensor: float) -> Dataset:
    """Return the session with other counts (M, J) in its frames, and their means over the holds in its presses."""
    assert given.frames is not None
    press, holding = given.frames.press, given.frames.phase == HOLD
    held = [counts[(press == p) & holding].mean(axis=0) for p in given.presses.press]
    return replace(
        given,
        meta=replace(given.meta, sensor=replace(given.meta.sensor, **sensor)),
        presses=replace(given.presses, counts=np.array(held)),
        frames=replace(given.frames, counts=counts),
    )


def still(*, clock: bool = False) -> Dataset:
    """Return the same presses without frames and covariates, with or without times."""
    data = moving()
    names = ("t_start_s", "t_hold_s", "t_release_s", "t_end_s") if clock else ()
    table = replace(data.presses, columns={name: data.presses.columns[name] for name in names})
    return replace(data, presses=table, frames=None)
