"""The presses and frames of a dataset as samples of a session, with the covariates that effects may need.

A frame has its own covariates; missing ones come from its press, and at rest from the previous press. In a dataset
without frames a standard press is simulated for each press (:func:`skincal.effects.hold_session`).

Throughout, ``touches``, or ``contacts`` and ``indenters``, are those of the given rows, ``rows`` (H,) are rows of the
table of presses, and ``poses`` are the names of the hand poses in the order of their numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skincal.covariates import NUMBERS, TIMES
from skincal.dataset import IDLE, Dataset
from skincal.effects import HoldSession, Samples, hold_session, hold_times, met_before
from skincal.effects.samples import UNKNOWN
from skincal.fitting.types import Floats, Ints
from skincal.model import Contacts
from skincal.model.arrays import FloatArray
from skincal.prediction.touches import Indenters, Touches, frame_presses, touching

SAME_SITE_M = 1e-4
"""Size of the grid cells in which positions count as one site [m]."""


def sites(dataset: Dataset) -> Ints:
    """Return the index of each press's site (P,): equal targets, or without targets equal measured positions."""
    presses = dataset.presses
    targets = [presses.column(f"target_{axis}_m") for axis in "xyz"]
    given = [t for t in targets if t is not None]
    points, has_target = presses.position_m, np.zeros(len(presses), dtype=np.bool_)
    if len(given) == 3:
        target = np.stack(given, axis=1)
        has_target = np.asarray(np.isfinite(target).all(axis=1))
        points = np.where(has_target[:, None], target, points)
    cells = np.round(np.nan_to_num(points) / SAME_SITE_M).astype(np.int64)
    return (
        np.unique(np.column_stack([has_target, cells]), axis=0, return_inverse=True)[1]
        .reshape(-1)
        .astype(np.intp)
    )


def met_forces(dataset: Dataset, rows: Ints) -> FloatArray | None:
    """Return the largest hold force of earlier touches of the same site (H,) [N].

    None if touches are not counted, or if the dataset has none of the earlier touches that a press counts: without
    targets, measured positions mostly all differ.
    """
    cycle = _cycles(dataset)
    if cycle is None:
        return None
    order, met = _in_time(dataset), np.empty(len(cycle))
    met[order] = met_before(sites(dataset)[order], cycle[order], dataset.presses.force_n[order])
    return None if np.isnan(met[cycle > 0]).any() else met[rows]


def _cycles(dataset: Dataset) -> FloatArray | None:
    """Return the number of earlier touches of each press's site (P,), from its first frame if there is no column."""
    own, frames = dataset.presses.column("cycle"), dataset.frames
    of_frames = None if frames is None else frames.column("cycle")
    if own is not None or of_frames is None:
        return own
    return _of_first_frames(dataset, of_frames)


def _in_time(dataset: Dataset) -> Ints:
    """Return the rows of presses in the order of their start; in the order of the table if it is not recorded."""
    start = dataset.presses.column("t_start_s")
    if start is None or not np.isfinite(start).all():
        if dataset.frames is None:
            return np.arange(len(dataset.presses))
        start = _of_first_frames(dataset, dataset.frames.time_s)
    return np.argsort(start, kind="stable")


def _of_first_frames(dataset: Dataset, values: FloatArray) -> FloatArray:
    """Return the values (P,) in each press's first frame with contact, from values of frames (M,); NaN without one."""
    touch = np.flatnonzero(touching(dataset))
    rows, first = np.unique(frame_presses(dataset)[touch], return_index=True)
    found = np.full(len(dataset.presses), np.nan)
    found[rows] = values[touch[first]]
    return found


Column = Callable[[str], NDArray[Any] | None]
"""Function that returns a column of the samples by its name; None if it is missing."""


def pose_names(dataset: Dataset) -> tuple[str, ...]:
    """Return the names of a dataset's hand poses, sorted."""
    tables = [table for table in (dataset.presses, dataset.frames) if table is not None]
    columns = [column for table in tables if (column := table.column("pose")) is not None]
    return tuple(sorted({name for column in columns for name in np.unique(_names(column)).tolist()} - {""}))


def pose_numbers(column: NDArray[Any], poses: Sequence[str]) -> Ints:
    """Return the numbers of poses by their names (N,); -1 for an empty name."""
    number = {name: i for i, name in enumerate(poses)}
    names, which = np.unique(_names(column), return_inverse=True)
    return np.array([number.get(name, UNKNOWN) for name in names.tolist()], dtype=np.intp)[which.reshape(-1)]


def _names(column: NDArray[Any]) -> NDArray[np.str_]:
    text = column.astype(str)
    return np.where(np.isin(text, ["nan", "None"]), "", text)


def frame_samples(touches: Touches, dataset: Dataset, poses: Sequence[str]) -> Samples:
    """Return one sample per frame."""
    frames, touch = dataset.frames, touching(dataset)
    assert frames is not None
    owner = last_press(frame_presses(dataset), touch)
    # A press of unknown position has no image, unless it has no force either.
    touch = touch & ((touches.force_n > 0) | np.isfinite(touches.points_m).all(axis=1))
    return Samples.of(
        touches.contacts(),
        touches.indenters(),
        **covariates(dataset, owner, lambda name: frame_column(dataset, owner, name), poses),
        touching=touch,
        press=np.where(touch, frames.press, -1),
        time_s=frames.time_s,
        phase=np.where(touching(dataset), frames.phase, IDLE),
    )


def frame_column(dataset: Dataset, owner: Ints, name: str) -> NDArray[Any] | None:
    """Return a column of the frames (M,), with missing values from their presses; ``owner`` is :func:`last_press`."""
    assert dataset.frames is not None
    own, of = dataset.frames.column(name), dataset.presses.column(name)
    if own is None or of is None:
        return own if of is None else of[owner]
    missing = ~np.isfinite(own) if own.dtype.kind == "f" else _names(own) == ""
    return np.where(missing, of[owner], own)


def last_press(owner: Ints, touch: NDArray[np.bool_]) -> Ints:
    """Return the row of each frame's press (M,); at rest that of the previous press, initially that of the first.

    Args:
        owner: (M,) row of the press, during contact.
        touch: (M,) True during contact.
    """
    if not touch.any():
        return np.zeros(len(touch), dtype=np.intp)
    last = np.maximum.accumulate(np.where(touch, np.arange(len(touch)), -1))
    return owner[np.where(last < 0, int(np.argmax(touch)), last)]


def hold_samples(
    contacts: Contacts, indenters: Indenters, dataset: Dataset, rows: Ints, poses: Sequence[str], **more: Any
) -> Samples:
    """Return one sample per press in its hold; ``more`` are further arguments of :meth:`skincal.effects.Samples.of`."""

    def column(name: str) -> NDArray[Any] | None:
        of = dataset.presses.column(name)
        return None if of is None else of[rows]

    return Samples.of(
        contacts,
        indenters,
        **covariates(dataset, rows, column, poses),
        touching=(contacts.force_n > 0) | np.isfinite(contacts.points_m).all(axis=1),
        press=dataset.presses.press[rows],
        **more,
    )


def standard_presses(
    contacts: Contacts, indenters: Indenters, dataset: Dataset, rows: Ints, poses: Sequence[str]
) -> HoldSession:
    """Return standard presses for the holds of a dataset. Without a clock, samples have neither times nor phases."""
    given, clock = press_times(dataset)
    times = hold_times(len(rows), *((g[rows] for g in given) if clock else ()))
    branch = dataset.presses.column("branch")
    down = None if branch is None else branch[rows] == "down"
    played = hold_session(hold_samples(contacts, indenters, dataset, rows, poses), times, down=down)
    if clock:
        return played
    return replace(played, samples=replace(played.samples, time_s=None, phase=None, start_s=float("nan")))


def press_order(dataset: Dataset) -> Ints:
    """Return the rows of presses in the order of time; in the order of the table if times are unknown."""
    given, clock = press_times(dataset)
    return np.argsort(given[0], kind="stable") if clock else np.arange(len(dataset.presses))


def press_times(dataset: Dataset) -> tuple[list[Floats], bool]:
    """Return start, hold, release and end of all presses [s], and whether all of them are known."""
    found = [column for name in TIMES if (column := dataset.presses.column(name)) is not None]
    known = len(found) == len(TIMES) and all(bool(np.isfinite(column).all()) for column in found)
    return found, known


def session_samples(touches: Touches, dataset: Dataset, poses: Sequence[str]) -> Samples:
    """Return the samples of a dataset: its frames, or the steps of standard presses."""
    if dataset.frames is not None:
        return frame_samples(touches, dataset, poses)
    rows = press_order(dataset)
    of_rows = touches.select(rows)
    return standard_presses(of_rows.contacts(), of_rows.indenters(), dataset, rows, poses).samples


def covariates(dataset: Dataset, rows: Ints, column: Column, poses: Sequence[str]) -> dict[str, Any]:
    """Return the recorded and computed covariates of M samples, as arguments of :meth:`skincal.effects.Samples.of`.

    Args:
        dataset: the dataset.
        rows: (M,) row of each sample's press.
        column: function that returns a column of the samples (M,) by its name, or None.
        poses: names of the hand poses.
    """
    met_n = met_forces(dataset, rows)
    found: dict[str, Any] = {} if met_n is None else {"met_n": met_n}
    for covariate in NUMBERS:
        parts = {name: values for name in covariate.columns if (values := column(name)) is not None}
        if len(parts) == len(covariate.columns) and all(np.isfinite(part).any() for part in parts.values()):
            found |= parts
    pose = column("pose")
    if pose is not None and poses:
        found["pose"] = pose_numbers(pose, poses)
    return found
