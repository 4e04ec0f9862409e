"""The record of a press: its frames at the sensor's rate, and one row of means over the steady part of the hold."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skincal.collect.plan import PlannedPress
from skincal.collect.press import Moments, Status
from skincal.collect.press_options import CollectOptions
from skincal.collect.senses import Sample
from skincal.covariates import POSITION, TARGET, TIMES
from skincal.dataset import HOLD, IDLE, LOAD, UNLOAD
from skincal.model.arrays import FloatArray, as_floats
from skincal.robot.description import joint_columns

Arrays = dict[str, NDArray[Any]]

SLIP_PARTS = 5
"""Number of equal parts into which a hold is divided to detect motion of the contact."""

OF_CONTACT = ("force_n", "shear_u_n", "shear_v_n")
"""Numbers of a sample that are recorded, beside its point."""
OF_SKIN = ("temperature_c",)
"""Numbers of a state that are recorded, where they are measured."""
OF_JOINTS = ("q", "tau", "q_desired")
"""Values of the joints that are recorded, of ``JOINT_FIELDS``."""

SHORTEST_S = 0.05
"""Without a steady part, a press's means cover at least this time before its end [s]."""


@dataclass(frozen=True, eq=False)
class Series:
    """Samples as arrays over time.

    Attributes:
        time_s: session clock (T,) [s].
        values: force, shears, point, angles, torques and commanded angles, each (T,) by the name of its column.
    """

    time_s: FloatArray
    values: dict[str, FloatArray]

    @classmethod
    def of(cls, samples: Sequence[Sample]) -> Series:
        """Return the samples of a stretch of time as arrays."""
        states = [sample.state for sample in samples]
        values = {name: as_floats([getattr(sample, name) for sample in samples]) for name in OF_CONTACT}
        values |= zip(POSITION, as_floats([sample.point_m for sample in samples]).T, strict=True)
        values |= {name: as_floats([getattr(state, name) for state in states]) for name in OF_SKIN}
        values |= joint_columns(states, OF_JOINTS)
        return cls(as_floats([sample.time_s for sample in samples]), values)

    def at(self, times_s: FloatArray) -> dict[str, FloatArray]:
        """Return the values at other times (M,), interpolated linearly."""
        return {name: np.interp(times_s, self.time_s, column) for name, column in self.values.items()}


def frames_of(samples: Sequence[Sample], last_s: float, rate_hz: float) -> Arrays:
    """Return the frames of the taxels, thinned to a rate, each with the joints' values at the time it was read.

    Returns:
        Columns by name: ``time_s``, ``counts`` (M, J) and those of :class:`Series`; M is 0 without a new frame.
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
    return {"time_s": times, "counts": counts, **Series.of(samples).at(times)}


def press_arrays(
    number: int,
    cycle: int,
    planned: PlannedPress,
    target_m: FloatArray,
    moments: Moments,
    lost: bool,
    samples: Sequence[Sample],
    last_frame_s: float,
    tare_nm: FloatArray,
    options: CollectOptions,
) -> Arrays:
    """Return all that is stored of a press: arrays ``press.*`` of the row, ``frames.*`` of the frames."""
    frames = frames_of(samples, last_frame_s, options.frame_rate_hz)
    series = Series.of(samples)
    steady = _steady(series.time_s, moments, options.settle_s)
    means = {name: float(np.mean(column[steady])) for name, column in series.values.items()}
    slip_m = _slip(series, moments)
    missed = missed_target(planned, means["force_n"], options)
    row = press_row(number, cycle, planned, target_m, moments, means, missed)
    row |= {"slip_m": slip_m, "status": _status(missed, slip_m, moments, lost, options)}
    row |= {f"tau_rest_{j}": float(value) for j, value in enumerate(tare_nm)}
    if planned.indenter_radius_m is not None:
        row["indenter_radius_m"] = planned.indenter_radius_m
    row["counts"] = _mean_image(frames, series.time_s[steady])
    frames |= phase_columns(_phases(frames["time_s"], moments), number, cycle, planned)
    frames["pose"] = np.full(len(frames["time_s"]), planned.pose)
    return named("press", row) | named("frames", frames)


def press_row(
    number: int,
    cycle: int,
    planned: PlannedPress,
    target_m: FloatArray,
    moments: Moments,
    means: Mapping[str, float],
    missed: bool,
) -> dict[str, Any]:
    """Return what the row of a press holds on every rig, by column; arguments as for :func:`press_arrays`."""
    return {
        "press": number,
        **means,
        **dict(zip(TIMES, astuple(moments), strict=True)),
        **dict(zip(TARGET, target_m, strict=True)),
        "target_force_n": planned.force_n,
        "speed_m_per_s": planned.speed_m_per_s,
        "pose": planned.pose,
        "cycle": cycle,
        "kind": planned.kind,
        "missed_target": int(missed),
    }


def phase_columns(phase: NDArray[np.int8], number: int, cycle: int, planned: PlannedPress) -> Arrays:
    """Return the columns of frames (M,) that say which press they belong to; idle ones belong to none."""
    touched = phase != IDLE
    return {
        "phase": phase,
        "press": np.where(touched, number, -1),
        "cycle": np.where(touched, float(cycle), np.nan),
        "speed_m_per_s": np.where(touched, planned.speed_m_per_s, np.nan),
    }


def rest_columns(count: int) -> Arrays:
    """Return the same columns for frames without contact, outside of presses."""
    nothing = np.full(count, np.nan)
    return {
        "phase": np.full(count, IDLE),
        "press": np.full(count, -1),
        "cycle": nothing,
        "speed_m_per_s": nothing,
    }


def named(table: str, columns: Mapping[str, Any]) -> Arrays:
    """Return columns by the names that they have in the journal."""
    return {f"{table}.{name}": np.asarray(column) for name, column in columns.items()}


def rest_arrays(samples: Sequence[Sample], last_frame_s: float, options: CollectOptions, pose: str) -> Arrays:
    """Return the record of the skin without contact, outside of presses."""
    frames = frames_of(samples, last_frame_s, options.frame_rate_hz)
    count = len(frames["time_s"])
    return named("frames", {**frames, **rest_columns(count), "pose": np.full(count, pose)})


def missed_target(planned: PlannedPress, force_n: float, options: CollectOptions) -> bool:
    """Return whether a force is farther from its target than the tolerance."""
    return abs(force_n - planned.force_n) > max(
        options.tolerance_n, options.tolerance_share * planned.force_n
    )


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


def _slip(series: Series, moments: Moments) -> float:
    """Return how far the contact point moved from its place at the start of the hold [m]; NaN without a hold."""
    held = (series.time_s >= moments.hold_s) & (series.time_s <= moments.release_s)
    if not held.any():
        return float("nan")
    points = np.stack([series.values[name][held] for name in POSITION], axis=1)
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
