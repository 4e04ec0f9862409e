"""Convert a dataset to the samples and observations of a diagnosis."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.special import fdtri

from skincal.calibration import MARGIN_M
from skincal.dataset import HOLD, IDLE, Dataset
from skincal.dataset.dataset import refusal
from skincal.dataset.uniform_pressure import centre_contacts
from skincal.effects import Samples
from skincal.effects.samples import UNLOAD
from skincal.inference.session import Binning, GapSession, binned, of_holds
from skincal.model import Contacts
from skincal.model.arrays import BoolArray, FloatArray, IntArray
from skincal.prediction.session_samples import (
    covariates,
    frame_column,
    last_press,
    pose_names,
    press_order,
    press_times,
    sites,
    standard_presses,
)
from skincal.prediction.touches import frame_normals
from skincal.statistics import robust_sigma

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

REST_SIGMAS = 5.0
"""Standard deviations of the force at rest, above which a frame is not at rest."""


def gap_session(dataset: Dataset, binning: Binning | None = None) -> GapSession:
    """Return the session of a dataset: frames averaged in bins, or the hold means if there are no frames.

    The observations leave out presses without a known position or force (uniform pressure needs no position), and
    frames between presses whose force shows contact.
    """
    dataset = centre_contacts(dataset, MARGIN_M)
    return _of_presses(dataset) if dataset.frames is None else _of_frames(dataset, binning)


def press_rows(dataset: Dataset) -> Ints:
    """Return the row (M,) in the press table of each frame, -1 at rest and for presses that are not in the table."""
    frames = dataset.frames
    assert frames is not None
    return np.where((frames.press >= 0) & (frames.phase != IDLE), dataset.frame_presses(), -1)


def _of_frames(dataset: Dataset, binning: Binning | None) -> GapSession:
    """Return the session of a dataset with frames."""
    frames, presses = dataset.frames, dataset.presses
    assert frames is not None
    row = press_rows(dataset)
    force = np.where(row >= 0, frames.force_n, 0.0)
    phase = frames.phase.astype(np.int64)
    position = smooth_positions(np.where((row >= 0)[:, None], frames.position_m, np.nan), force, row, phase)
    located = np.isfinite(position).all(axis=1) & np.isfinite(force)
    use = np.where(row < 0, ~_is_pressed_at_rest(dataset), located & ~_is_noted_ramp(force, row, phase))
    owner = last_press(row, row >= 0)

    def column(name: str) -> NDArray[Any] | None:
        values = frame_column(dataset, owner, name)
        return None if values is None else values[use]

    row, of_press = row[use], owner[use]
    measured = frame_normals(dataset)
    normals = None if measured is None else np.asarray(measured[use], dtype=np.float64)
    indenters, kinds = dataset.indenters()
    samples = Samples.of(
        _contacts(dataset, position[use], force[use], normals),
        (indenters, kinds[of_press]),
        touching=row >= 0,
        press=np.where(row >= 0, presses.press[of_press], -1),
        time_s=frames.time_s[use],
        phase=frames.phase[use],
        **covariates(dataset, of_press, column, pose_names(dataset)),
    )
    return binned(samples, row, frames.counts[use], dataset.surface(), binning)


def _is_noted_ramp(force: Floats, row: Ints, phase: Ints) -> NDArray[np.bool_]:
    """Return the frames (M,) outside the hold of presses whose force was noted, not measured: the same in all frames.

    How much of a weight the skin bears while it is laid on or taken off is unknown.
    """
    held = phase == HOLD
    presses = pd.DataFrame({"row": row, "force": force, "held": held}).groupby("row")
    most, least = (presses[["force", "held"]].transform(end) for end in ("max", "min"))
    return (row >= 0) & ~held & (most.held & (most.force == least.force)).to_numpy()


def _is_pressed_at_rest(dataset: Dataset) -> NDArray[np.bool_]:
    """Return whether a frame (M,) is labelled as rest although its force shows contact."""
    frames = dataset.frames
    assert frames is not None
    rest = (frames.phase == IDLE) & np.isfinite(frames.force_n)
    if not rest.any():
        return rest
    at_rest = frames.force_n[rest]
    return rest & (frames.force_n > np.median(at_rest) + REST_SIGMAS * robust_sigma(at_rest))


def _of_presses(dataset: Dataset) -> GapSession:
    """Return the session of a dataset without frames: a standard press for each hold mean."""
    presses, order = dataset.presses, press_order(dataset)
    use = order[np.isfinite(presses.position_m[order]).all(axis=1) & (presses.force_n[order] > 0)]
    indenters, kinds = dataset.indenters()
    normals = None if presses.normals is None else presses.normals[use]
    contacts = _contacts(dataset, presses.position_m[use], presses.force_n[use], normals)
    played = standard_presses(contacts, (indenters, kinds[use]), dataset, use, pose_names(dataset))
    session = of_holds(played, presses.counts[use], clock=press_times(dataset)[1])
    return replace(session, row=use[session.row], press=use[session.press])


def _contacts(dataset: Dataset, position: Floats, force: Floats, normals: Floats | None) -> Contacts:
    """Return contacts projected on the surface, with measured normals (M, 3), else those of the surface."""
    surface, known = dataset.surface(), np.isfinite(position).all(axis=1)
    points, out = np.full(position.shape, np.nan), np.tile([0.0, 0.0, 1.0], (len(position), 1))
    points[known] = surface.project(position[known])
    out[known] = surface.normal_at(points[known])
    if normals is not None:
        measured = known & np.isfinite(normals).all(axis=1)
        out[measured] = normals[measured] / np.linalg.norm(normals[measured], axis=1, keepdims=True)
    return Contacts(points, out, force)


def repeats(dataset: Dataset) -> tuple[Ints, Ints]:
    """Return the rows of presses and of their next exact repeats (same site, force, speed, pose, indenter, branch)."""
    presses, site = dataset.presses, sites(dataset)
    force = presses.column("target_force_n")
    if force is None or presses.column("target_x_m") is None:
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    groups: dict[tuple[Any, ...], list[int]] = {}
    others = [presses.column(name) for name in ("pose", "speed_m_per_s", "indenter_radius_m", "branch")]
    for k in range(len(presses)):
        settings = tuple(None if c is None else str(c[k]) for c in others)
        groups.setdefault((int(site[k]), round(float(force[k]), 3), *settings), []).append(k)
    pairs = [pair for rows in groups.values() for pair in pairwise(rows)]
    repeated = np.array(pairs, dtype=np.int64).reshape(-1, 2)
    return repeated[:, 0], repeated[:, 1]


def hold_groups(dataset: Dataset) -> Ints:
    """Return the row (M,) of the press whose hold each frame belongs to, -1 outside holds."""
    frames = dataset.frames
    assert frames is not None
    return np.where(frames.phase == HOLD, press_rows(dataset), -1)


def check_phases(dataset: Dataset, fewest: int) -> None:
    """Refuse frames that mark too few presses as contact, or locate too few, although the press table has enough.

    Args:
        dataset: the session.
        fewest: number of presses required.

    Raises:
        WorkError: the table has ``fewest`` presses with a position and a force, and the frames have not.
    """
    table = dataset.presses
    located = int((np.isfinite(table.position_m).all(axis=1) & (table.force_n > 0)).sum())
    if dataset.frames is None or located < fewest:
        return
    rows = press_rows(dataset)
    touched = len(np.unique(rows[rows >= 0]))
    wanted = "a press" if fewest == 1 else f"{fewest} presses"
    what = "columns x_m, y_m, z_m and force_n: expected a place and a force in"
    if touched < fewest:
        what = "columns press and phase: expected"
    else:
        known = np.isfinite(dataset.frames.position_m).all(axis=1) & np.isfinite(dataset.frames.force_n)
        touched = len(np.unique(rows[known & (rows >= 0)]))
        if touched >= fewest:
            return
    raise refusal(
        dataset,
        f"frames, {what} load, hold and unload frames of {wanted} at least; "
        f"got such frames of {touched} of {len(table)}. Correct them, or leave the frames out",
    )


_FEWEST = 6
"""Least number of frames of a press, and of degrees of freedom of a test."""
_SMOOTH = 0.25
"""Ratio of half the squared differences of neighbours to the squared residuals, 1 for white noise, below which the
residuals are a motion. Set by eye."""
_EXACT_M = 1e-9
"""Improvement below which positions count as equal [m]."""
_SIGNIFICANCE = 1e-3
"""Significance level of the F test for one more column."""


def smooth_positions(
    position_m: FloatArray, force_n: FloatArray, row: IntArray, phase: IntArray
) -> FloatArray:
    """Return the positions (M, 3) [m] of frames, smoothed press by press.

    Positions from joint angles scatter from frame to frame, which the skin does not feel. A hand that gives way moves
    the contact a little as the force rises, so the position of a press is fitted as a linear function of its force;
    where an F test shows the need, with a separate path for unloading (friction in the joints) and a curve. A press
    whose residuals change smoothly in time, such as one that slides, keeps its measured positions.

    Args:
        position_m: (M, 3) measured positions [m], NaN without contact.
        force_n: (M,) forces [N].
        row: (M,) row of the press of each frame, -1 at rest.
        phase: (M,) phases, as in :class:`skincal.effects.Samples`.
    """
    smooth = position_m.copy()
    known = (row >= 0) & np.isfinite(position_m).all(axis=1) & np.isfinite(force_n)
    order = np.flatnonzero(known)[np.argsort(row[known], kind="stable")]
    for own in np.split(order, np.flatnonzero(np.diff(row[order])) + 1):
        if len(own) >= _FEWEST:
            smooth[own] = _smooth_press(position_m[own], force_n[own], phase[own] == UNLOAD)
    return smooth


def _smooth_press(position_m: FloatArray, force_n: FloatArray, is_unloading: BoolArray) -> FloatArray:
    """Return the smoothed positions (m, 3) of one press, whose frames are in the order of time."""
    share = force_n / max(float(np.abs(force_n).max()), 1e-12)
    columns = np.stack([np.ones_like(share), share], axis=1)
    path = _project(columns, position_m)
    for extra in ((1 - share) * is_unloading, share * (1 - share)):
        more = np.column_stack([columns, extra])
        other = _project(more, position_m)
        if _is_significant(position_m, path, other, len(position_m) - more.shape[1]):
            columns, path = more, other
    residual = position_m - path
    total = float((residual**2).sum())
    if 0.5 * float((np.diff(residual, axis=0) ** 2).sum()) < _SMOOTH * total:
        return position_m
    return path


def _project(columns: FloatArray, position_m: FloatArray) -> FloatArray:
    """Return the least-squares fit of positions by columns."""
    return columns @ np.linalg.lstsq(columns, position_m, rcond=None)[0]


def _is_significant(position_m: FloatArray, path: FloatArray, longer: FloatArray, dof: int) -> bool:
    """Test whether a path with one more column, and ``dof`` degrees of freedom left, fits better (F test)."""
    if dof < _FEWEST:
        return False
    before, after = (float(((position_m - p) ** 2).sum()) for p in (path, longer))
    if before - after <= _EXACT_M**2 * position_m.size:
        return False
    # Number of independent directions of the noise: two along a surface, about one for a single joint.
    spread = np.linalg.eigvalsh((position_m - longer).T @ (position_m - longer))
    axes = max(float(spread.sum() ** 2 / max(float((spread**2).sum()), np.finfo(float).tiny)), 1.0)
    return (before - after) * dof > after * float(fdtri(axes, axes * dof, 1 - _SIGNIFICANCE))
