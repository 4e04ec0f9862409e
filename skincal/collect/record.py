"""The record of a press: its frames at the sensor's rate, and one row of means over the steady part of the hold."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skincal.collect.journal import Arrays
from skincal.collect.plan import CollectOptions
from skincal.collect.press import Moments, Status
from skincal.collect.senses import Sample
from skincal.collect.session import Session
from skincal.covariates import POSITION
from skincal.dataset import HOLD, IDLE, LOAD, UNLOAD
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
