"""A dataset as the diagnosis sees it."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skincal.calibration import MARGIN_M
from skincal.covariates import TIMES
from skincal.dataset import HOLD, IDLE, Dataset
from skincal.dataset.uniform_pressure import centre_contacts
from skincal.diagnosis.steady import steady_places
from skincal.effects import Samples, hold_session, hold_times
from skincal.inference.session import Binning, GapSession, binned, of_holds
from skincal.model import Contacts
from skincal.prediction.session_samples import covariates, frame_column, last_press, pose_names, sites
from skincal.prediction.touches import frame_normals

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

RESTING = 5.0
"""A force within so many standard deviations of that at rest is rest."""


def gap_session(dataset: Dataset, binning: Binning | None = None) -> GapSession:
    """The session of a dataset: its frames in bins, or the hold means of its presses where it has no frames.

    Presses without a known place, or without force, are left out of the observations (uniform pressure needs no place),
    and frames between presses in which something still presses, or does already, as their force says.
    """
    dataset = centre_contacts(dataset, MARGIN_M)
    return _of_presses(dataset) if dataset.frames is None else _of_frames(dataset, binning)


def press_rows(dataset: Dataset) -> Ints:
    """Row of the table of presses that each frame (M,) belongs to, -1 at rest and for presses that are unknown."""
    frames, press = dataset.frames, dataset.presses.press
    assert frames is not None
    order = np.argsort(press)
    place = np.minimum(np.searchsorted(press[order], frames.press), len(press) - 1)
    known = (press[order][place] == frames.press) & (frames.press >= 0) & (frames.phase != IDLE)
    return np.where(known, order[place], -1)


def _of_frames(dataset: Dataset, binning: Binning | None) -> GapSession:
    frames, presses = dataset.frames, dataset.presses
    assert frames is not None
    row = press_rows(dataset)
    force = np.where(row >= 0, frames.force_n, 0.0)
    phase = frames.phase.astype(np.int64)
    place = steady_places(np.where((row >= 0)[:, None], frames.position_m, np.nan), force, row, phase)
    use = np.where(row < 0, ~_pressed_at_rest(dataset), np.isfinite(place).all(axis=1) & np.isfinite(force))
    owner = last_press(row, row >= 0)

    def column(name: str) -> NDArray[Any] | None:
        found = frame_column(dataset, owner, name)
        return None if found is None else found[use]

    row, of_press = row[use], owner[use]
    measured = frame_normals(dataset)
    normals = None if measured is None else np.asarray(measured[use], dtype=np.float64)
    indenters, kinds = dataset.indenters()
    samples = Samples.of(
        _contacts(dataset, place[use], force[use], normals),
        (indenters, kinds[of_press]),
        touching=row >= 0,
        press=np.where(row >= 0, presses.press[of_press], -1),
        time_s=frames.time_s[use],
        phase=frames.phase[use],
        **covariates(dataset, of_press, column, pose_names(dataset)),
    )
    return binned(samples, row, frames.counts[use], dataset.surface(), binning)


def _pressed_at_rest(dataset: Dataset) -> NDArray[np.bool_]:
    """(M,) whether a frame has the phase of rest and more force than rest has: a threshold cuts phases late."""
    frames = dataset.frames
    assert frames is not None
    rest = (frames.phase == IDLE) & np.isfinite(frames.force_n)
    if not rest.any():
        return rest
    middle = np.median(frames.force_n[rest])
    scatter = 1.4826 * np.median(np.abs(frames.force_n[rest] - middle))
    return rest & (frames.force_n > middle + RESTING * scatter)


def _of_presses(dataset: Dataset) -> GapSession:
    presses = dataset.presses
    given = [presses.column(name) for name in TIMES]
    clock = all(g is not None and bool(np.isfinite(g).all()) for g in given)
    order = np.argsort(given[0], kind="stable") if clock and given[0] is not None else np.arange(len(presses))
    use = order[np.isfinite(presses.position_m[order]).all(axis=1) & (presses.force_n[order] > 0)]
    times = hold_times(len(use), *(None if g is None or not clock else g[use] for g in given))
    indenters, kinds = dataset.indenters()

    def column(name: str) -> NDArray[Any] | None:
        of = presses.column(name)
        return None if of is None else of[use]

    normals = None if presses.normals is None else presses.normals[use]
    holds = Samples.of(
        _contacts(dataset, presses.position_m[use], presses.force_n[use], normals),
        (indenters, kinds[use]),
        touching=True,
        press=presses.press[use],
        **covariates(dataset, use, column, pose_names(dataset)),
    )
    branch = column("branch")
    played = hold_session(holds, times, down=None if branch is None else branch == "down")
    session = of_holds(played, presses.counts[use], clock=clock)
    return replace(session, row=use[session.row], press=use[session.press])


def _contacts(dataset: Dataset, place: Floats, force: Floats, normals: Floats | None) -> Contacts:
    """Contacts on the surface, with its own normals where none were measured."""
    surface, known = dataset.surface(), np.isfinite(place).all(axis=1)
    points, out = np.full(place.shape, np.nan), np.tile([0.0, 0.0, 1.0], (len(place), 1))
    points[known] = surface.project(place[known])
    out[known] = surface.normal_at(points[known])
    if normals is not None:
        measured = known & np.isfinite(normals).all(axis=1)
        out[measured] = normals[measured] / np.linalg.norm(normals[measured], axis=1, keepdims=True)
    return Contacts(points, out, force)


def repeats(dataset: Dataset) -> tuple[Ints, Ints]:
    """Rows of presses and of exact repeats of them: same site, force, pace, pose and indenter, and no first touch."""
    presses, site = dataset.presses, sites(dataset)
    force = presses.column("target_force_n")
    if force is None or presses.column("target_x_m") is None:
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    keys: dict[tuple[Any, ...], list[int]] = {}
    others = [presses.column(name) for name in ("pose", "speed_m_per_s", "indenter_radius_m", "branch")]
    for k in range(len(presses)):
        own = tuple(None if c is None else str(c[k]) for c in others)
        keys.setdefault((int(site[k]), round(float(force[k]), 3), *own), []).append(k)
    pairs = [(a, b) for rows in keys.values() for a, b in pairwise(rows)]
    both = np.array(pairs, dtype=np.int64).reshape(-1, 2)
    return both[:, 0], both[:, 1]


def hold_groups(dataset: Dataset) -> Ints:
    """The press (M,) whose hold each frame belongs to, -1 for frames that are no hold."""
    frames = dataset.frames
    assert frames is not None
    return np.where(frames.phase == HOLD, press_rows(dataset), -1)
