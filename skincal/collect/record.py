"""The record of presses: frames at the sensor's rate, a row of means each; and the dataset that a journal becomes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skincal.collect.journal import Arrays, Journal
from skincal.collect.plan import CollectOptions
from skincal.collect.press import Moments, Status
from skincal.collect.senses import Sample
from skincal.collect.session import Session
from skincal.covariates import POSITION
from skincal.dataset import HOLD, IDLE, LOAD, UNLOAD, Dataset, DatasetMeta, Frames, Presses
from skincal.dataset.rest import ACTIVE_COUNTS
from skincal.dataset.table_conversion import DEAD_STRETCH, long_stretches
from skincal.errors import Problem
from skincal.model.arrays import FloatArray, as_floats
from skincal.robot.description import joint_columns

SLIP_PARTS = 5
"""Number of equal parts into which a hold is divided to detect motion of the contact."""

OF_SAMPLE = ("time_s", "force_n", "shear_u_n", "shear_v_n")
"""Numbers of a sample that are recorded, beside its point."""
OF_SKIN = ("temperature_c",)
"""Numbers of a state that are recorded, where they are measured."""
OF_JOINTS = ("q", "tau", "q_desired")
"""Values of the joints that are recorded, of ``JOINT_FIELDS``."""

SHORTEST_S = 0.05
"""Without a steady part, a press's means cover at least this time before its end [s]."""


def series_of(samples: Sequence[Sample]) -> Arrays:
    """Return samples over time (T,) by column; ``time_s`` is the session's clock [s]."""
    states = [sample.state for sample in samples]
    values = {name: as_floats([getattr(sample, name) for sample in samples]) for name in OF_SAMPLE}
    values |= zip(POSITION, as_floats([sample.point_m for sample in samples]).T, strict=True)
    values |= {name: as_floats([getattr(state, name) for state in states]) for name in OF_SKIN}
    return values | joint_columns(states, OF_JOINTS)


def frames_of(samples: Sequence[Sample], last_s: float, rate_hz: float) -> Arrays:
    """Return the frames of the taxels, thinned to a rate, each with the joints' values at the time it was read.

    Returns:
        Columns by name: ``time_s``, ``counts`` (M, J) and those of :func:`series_of`; M is 0 without a new frame.
    """
    step_s = 1 / rate_hz
    period_s = (samples[-1].time_s - samples[0].time_s) / max(len(samples) - 1, 1)
    kept: list[Sample] = []
    for sample in samples:
        # A frame that comes half a period early is on time.
        if sample.frame_s > last_s and sample.frame_s >= last_s + step_s - 0.5 * period_s:
            kept.append(sample)
            last_s = sample.frame_s
    times = np.array([sample.frame_s for sample in kept], dtype=np.float64)
    counts = np.empty((len(kept), len(samples[0].state.taxels)))
    for row, sample in zip(counts, kept, strict=True):  # a slow sensor may have read none
        row[:] = sample.state.taxels
    series = series_of(samples)
    at_frames = {name: np.interp(times, series["time_s"], column) for name, column in series.items()}
    return {**at_frames, "time_s": times, "counts": counts}


def press_tables(
    session: Session,
    number: int,
    target_m: FloatArray,
    moments: Moments,
    samples: Sequence[Sample],
    tare_nm: FloatArray,
    *,
    lost: bool,
) -> tuple[dict[str, Any], Arrays]:
    """Return all that is stored of a press: its row and its frames, by column.

    Args:
        session: the session.
        number: number of the press.
        target_m: planned contact point (3,) [m].
        moments: starts of the parts of the press.
        samples: all samples since the press before.
        tare_nm: torques at rest (n,) [N m].
        lost: whether contact was lost in the hold.
    """
    options, planned = session.options, session.plan.presses[number]
    frames = frames_of(samples, session.last_frame_s, options.frame_rate_hz)
    series = series_of(samples)
    time_s = series["time_s"]
    steady = _steady(time_s, moments, options.settle_s)
    means = {name: float(np.mean(column[steady])) for name, column in series.items() if name != "time_s"}
    slip_m = _slip(series, moments)
    row = session.press_row(number, target_m, moments, means)
    missed = bool(row["missed_target"])
    row |= {"slip_m": slip_m, "status": _status(missed, slip_m, moments, lost, options)}
    row |= {f"tau_rest_{j}": float(value) for j, value in enumerate(tare_nm)}
    if planned.indenter_radius_m is not None:
        row["indenter_radius_m"] = planned.indenter_radius_m
    row["counts"] = _mean_image(frames, time_s[steady])
    frames |= session.phase_columns(_phases(frames["time_s"], moments), number)
    frames["pose"] = np.full(len(frames["time_s"]), planned.pose)
    return row, frames


def _status(missed: bool, slip_m: float, moments: Moments, lost: bool, options: CollectOptions) -> Status:
    if not np.isfinite(moments.hold_s):
        return "no_contact"
    if lost:
        return "lost_contact"
    if slip_m > options.slip_m:
        return "slipped"
    return "missed_target" if missed else "ok"


def _phases(time_s: FloatArray, moments: Moments) -> NDArray[np.int8]:
    """Return the phase of each frame; all idle if the skin was not found."""
    phase = np.full(len(time_s), IDLE, dtype=np.int8)
    for begin, code in (
        (moments.start_s, LOAD),
        (moments.hold_s, HOLD),
        (moments.release_s, UNLOAD),
        (moments.end_s, IDLE),
    ):
        if np.isfinite(begin):
            phase[time_s >= begin] = code
    return phase


def _steady(time_s: FloatArray, moments: Moments, settle_s: float) -> NDArray[np.bool_]:
    """Return the samples of the hold after settling, or its last moments if it was too short."""
    if not np.isfinite(moments.hold_s):
        lowest = time_s[-1] if not np.isfinite(moments.start_s) else moments.start_s
        return (time_s >= lowest - SHORTEST_S) & (time_s <= lowest)
    begin = min(moments.hold_s + settle_s, moments.release_s - SHORTEST_S)
    return (time_s >= begin) & (time_s <= moments.release_s)


def _slip(series: Arrays, moments: Moments) -> float:
    """Return how far the contact point moved from its place at the start of the hold [m]; NaN without a hold."""
    held = (series["time_s"] >= moments.hold_s) & (series["time_s"] <= moments.release_s)
    if not held.any():
        return float("nan")
    points = np.stack([series[name][held] for name in POSITION], axis=1)
    # Average over a while: the noise of the angles alone is some tenths of a millimetre.
    count = max(1, len(points) // SLIP_PARTS)
    parts = np.array([part.mean(axis=0) for part in np.array_split(points, max(len(points) // count, 1))])
    return float(np.linalg.norm(parts - parts[0], axis=1).max())


def _mean_image(frames: Arrays, times_s: FloatArray) -> FloatArray:
    """Return the mean of the images read in a stretch of time (J,) [counts]; the nearest image if there is none.

    NaN stands for taxels that were not read at all.
    """
    time_s, counts = frames["time_s"], frames["counts"]
    inside = (time_s >= times_s[0]) & (time_s <= times_s[-1])
    if len(time_s) and not inside.any():
        inside[np.argmin(np.abs(time_s - times_s.mean()))] = True
    number = np.isfinite(counts[inside]).sum(axis=0)
    total = np.nansum(counts[inside], axis=0)
    return np.where(number > 0, total / np.maximum(number, 1), np.nan)


OWN_OF_PRESSES = ("press", *POSITION, "force_n", "counts")
OWN_OF_FRAMES = (*OWN_OF_PRESSES, "phase", "time_s")
OPTIONAL = (*OF_SKIN, "indenter_radius_m")
"""Columns that are left out if nothing was measured."""

LAST = ("missed_target", "slip_m", "status", "kind")
"""Further columns, after those of the format."""


def dataset_of(journal: Journal, meta: DatasetMeta, source: str, created: datetime) -> Dataset:
    """Return the dataset of all finished presses, by number, and of the frames around them, in the order of time."""
    presses = [arrays for _, arrays in sorted(journal.presses().items())]
    stretches = [_part(arrays, "frames.") for arrays in [*presses, *journal.rests()]]
    stretches = [stretch for stretch in stretches if len(stretch["time_s"])]
    stretches.sort(key=lambda stretch: float(stretch["time_s"][0]))
    meta = replace(meta, source=source, created=created, sensor=replace(meta.sensor, baseline="raw"))
    return Dataset(meta, _presses([_part(arrays, "press.") for arrays in presses]), _frames(stretches))


def _presses(rows: Sequence[Arrays]) -> Presses:
    names = dict.fromkeys(name for row in rows for name in row)
    table = {name: np.array([row.get(name, np.nan) for row in rows]) for name in names}
    own = {name: table.pop(name) for name in OWN_OF_PRESSES}
    return Presses(
        own["press"].astype(np.int64),
        np.stack([own[name] for name in POSITION], axis=1),
        own["force_n"],
        own["counts"],
        columns=_ordered(_given(table)),
    )


def _frames(stretches: Sequence[Arrays]) -> Frames:
    table = {name: np.concatenate([s[name] for s in stretches]) for name in stretches[0]}
    kept = _answered(table["counts"])
    table = {name: column[kept] for name, column in table.items()}
    own = {name: table.pop(name) for name in OWN_OF_FRAMES}
    position = np.stack([own[name] for name in POSITION], axis=1)
    nothing = own["press"] < 0
    return Frames(
        own["press"].astype(np.int64), own["phase"].astype(np.int8), own["time_s"], own["force_n"],
        np.where(nothing[:, None], np.nan, position), own["counts"], columns=_given(table),
    )  # fmt: skip


def _answered(counts: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which frames (M,) are kept: a frame in which a taxel failed to respond for a moment is not an image."""
    kept = np.ones(len(counts), dtype=bool)
    while True:
        missing = np.isnan(counts[kept])
        # A taxel that is silent for long is dead, and its NaN stays.
        moment = missing & ~long_stretches(missing, DEAD_STRETCH) & ~missing.all(axis=0)
        if not moment.any():
            return kept
        kept[np.flatnonzero(kept)[moment.any(axis=1)]] = False


def _given(table: Arrays) -> Arrays:
    """Return the columns with text as objects, without columns in which nothing was measured."""
    return {
        name: column.astype(object) if column.dtype.kind == "U" else column
        for name, column in table.items()
        if not (name in OPTIONAL and column.dtype.kind == "f" and np.isnan(column).all())
    }


def _ordered(table: Arrays) -> Arrays:
    last = {
        name: table[name] for name in table if name in LAST or name.startswith(("tau_rest_", "q_desired_"))
    }
    return {name: column for name, column in table.items() if name not in last} | last


def _part(arrays: Arrays, prefix: str) -> Arrays:
    return {name.removeprefix(prefix): column for name, column in arrays.items() if name.startswith(prefix)}


AROUND = 3
"""Number of pauses on each side whose median is compared: a slow recovery of the skin is over in the next but one."""

SIGMAS = 8.0
"""A shift exceeds this many standard errors of the levels, and the threshold of an active taxel: noise alone
does not reach it in a hundred presses on a hundred taxels."""

FIX = (
    "If the sensor or its driver tares automatically, allow that only without contact; taxels that are tared under "
    "load read too low from then on."
)


def rest_shifts(dataset: Dataset) -> tuple[Problem, ...]:
    """Return the presses after which taxels rest at another level than before, permanently."""
    numbers, levels, errors = _pauses(dataset)
    problems: list[Problem] = []
    for k in range(1, len(levels)):
        # NaN for a taxel that is silent in one of the pauses.
        before = np.median(levels[max(k - AROUND, 0) : k], axis=0)
        after = np.median(levels[k : k + AROUND], axis=0)
        step, shift = np.abs(levels[k] - levels[k - 1]), np.abs(after - before)
        least = np.maximum(ACTIVE_COUNTS, SIGMAS * np.hypot(errors[k], errors[k - 1]))
        shifted = np.flatnonzero((shift > least) & (step > 0.5 * shift))
        if len(shifted):
            worst = int(shifted[np.argmax(shift[shifted])])
            name = dataset.meta.sensor.taxel_columns()[worst]
            more = f" ({len(shifted)} taxels in all)" if len(shifted) > 1 else ""
            got = f"{name} at {before[worst]:.3g} counts before and {after[worst]:.3g} after{more}"
            expected = "the same level at rest before and after it"
            problems.append(Problem(f"press {numbers[k - 1]}", expected, got, FIX))
    return tuple(problems)


def _pauses(dataset: Dataset) -> tuple[list[int], FloatArray, FloatArray]:
    """Return the presses between pauses, and the level at rest of each pause with its standard error, (pauses, J)."""
    frames = dataset.frames
    assert frames is not None
    idle = frames.phase == IDLE
    starts = np.flatnonzero(np.diff(idle, prepend=~idle[:1]))
    numbers: list[int] = []
    levels: list[FloatArray] = []
    errors: list[FloatArray] = []
    pressed = -1
    for begin, end in zip(starts, [*starts[1:], len(idle)], strict=True):
        counts = frames.counts[begin:end]
        if not idle[begin]:
            pressed = int(frames.press[begin])
        elif end - begin > 1:
            if levels:
                numbers.append(pressed)
            levels.append(np.mean(counts, axis=0))
            # Whole counts: a constant level is known to a part of a step.
            errors.append(np.maximum(counts.std(axis=0, ddof=1), 0.3) / np.sqrt(end - begin))
    shape = (len(levels), frames.counts.shape[1])
    return numbers, np.reshape(levels, shape), np.reshape(errors, shape)
