"""Rest levels of the taxels, their drift and the taxels that are active in a press; a summary in a few numbers."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from skincal.covariates import TARGET
from skincal.dataset.dataset import Dataset, session_times_s
from skincal.dataset.tables import IDLE, PHASES
from skincal.model.arrays import BoolArray, FloatArray, IntArray

ACTIVE_COUNTS = 5.0
"""Default threshold above the rest level from which a taxel is active [counts]."""

ACTIVE_SIGMAS = 6.0
"""Lower bound of the threshold in standard deviations of the noise at rest, for values that are not counts."""

ACTIVE_SHARE = 0.04
"""Threshold as a fraction of the largest value above rest, for values that are not counts; as in the fit."""

REST_IN_DOUBT = (
    "Without idle frames the level at rest is estimated from the presses, and some taxels then rest far above the "
    "others: if all presses load the same taxels equally, add frames at rest (phase idle), or press at other places"
)
"""Reason and advice if :func:`rest_in_doubt` is true."""

FEWEST_IDLE = 20
"""Smallest number of idle frames for an estimate of the rest level."""


def rest_levels(dataset: Dataset) -> FloatArray:
    """Return the rest level of each taxel [counts], shape (J,); NaN for a taxel that is always dead.

    It is the median over the idle frames. Without enough idle frames it is the mean of the low readings of the presses,
    most of which do not touch a given taxel. After subtraction of the rest level it is 0.
    """
    from skincal.model.rest import rest_from_presses

    if dataset.meta.sensor.baseline == "subtracted":
        return np.zeros(dataset.meta.sensor.taxels)
    levels = _of_idle_frames(dataset, np.nanmedian)
    return rest_from_presses(dataset.presses.counts)[0] if levels is None else levels


def rest_in_doubt(dataset: Dataset) -> bool:
    """Return whether the estimated rest level may be that of taxels which every press loads equally.

    With too few idle frames the level is estimated from the presses. The estimate is doubtful if one taxel lies clearly
    above most others, as when all presses have the same position and force.
    """
    if dataset.meta.sensor.baseline == "subtracted" or _idle(dataset) is not None:
        return False
    levels = rest_levels(dataset)
    levels = levels[np.isfinite(levels)]
    return bool(len(levels)) and float(levels.max() - np.median(levels)) > ACTIVE_COUNTS


def idle_means(dataset: Dataset) -> FloatArray | None:
    """Return the mean counts (J,) of the idle frames; noise that is clipped lifts them above the rest level.

    NaN for a taxel that is always dead; None with too few idle frames.
    """
    return _of_idle_frames(dataset, np.nanmean)


def noise_at_rest(dataset: Dataset) -> float:
    """Return the noise of an untouched taxel [counts]: the median standard deviation over the taxels; 0 if clipped.

    It comes from single idle frames if there are enough, else from the lower readings of the presses.
    """
    spreads = _of_idle_frames(dataset, _low_spread)
    if spreads is None:
        counts = dataset.presses.counts
        spreads = np.array([_low_spread(c) for c in counts.T if np.isfinite(c).any()])
    alive = spreads[np.isfinite(spreads)]
    return float(np.median(alive)) if alive.size else 0.0


def _low_spread(counts: FloatArray) -> np.floating:
    """Return the standard deviation from two lower quantiles, which are 1.028 sigmas apart for normal noise."""
    middle, low = np.quantile(counts[np.isfinite(counts)], (0.4, 0.1))
    return (middle - low) / 1.028


def active_threshold(dataset: Dataset) -> float:
    """Return the threshold above the rest level from which a taxel is active: five counts, or less for small values.

    Values in volts or in fractions of full scale never reach five. For values that are not whole numbers the threshold
    is a fraction of the largest one, at most five without a unit, and at least six sigmas of the noise at rest.
    """
    sensor = dataset.meta.sensor
    apart = dataset.presses.counts - rest_levels(dataset)
    top = float(np.nanmax(apart)) if np.isfinite(apart).any() else 0.0
    if sensor.unit == "counts" or (sensor.integer and top > ACTIVE_COUNTS):
        return ACTIVE_COUNTS
    most = ACTIVE_COUNTS if sensor.unit is None else np.inf
    return max(ACTIVE_SIGMAS * noise_at_rest(dataset), min(ACTIVE_SHARE * max(top, 0.0), most))


def _idle(dataset: Dataset) -> BoolArray | None:
    frames = dataset.frames
    if frames is None or np.sum(idle := frames.phase == IDLE) < FEWEST_IDLE:
        return None
    return idle


def _of_idle_frames(dataset: Dataset, statistic: Callable[[FloatArray], np.floating]) -> FloatArray | None:
    """Return a statistic of each taxel's counts over the idle frames (J,), NaN for a dead one; None if too few."""
    idle = _idle(dataset)
    if idle is None or dataset.frames is None:
        return None
    columns = (counts[idle] for counts in dataset.frames.taxel_columns())
    return np.array([statistic(c) if np.isfinite(c).any() else np.nan for c in columns], dtype=np.float64)


def active_taxels(dataset: Dataset, threshold_counts: float = ACTIVE_COUNTS) -> BoolArray:
    """Return which taxels are active in which press (K, J): more than a threshold [counts] above their level at rest.

    A dead taxel (NaN) is never active.
    """
    return dataset.presses.counts - rest_levels(dataset) > threshold_counts


NEAREST: Final = 25
"""Largest number of idle frames directly before a press that determine its rest level."""

_FEWEST, _CLEAR = 5, 3.0
"""Smallest number of presses for a variance, and distance from the lower bound, in standard deviations, from which
noise is not clipped."""


def rest_drift(dataset: Dataset) -> FloatArray | None:
    """Estimate the drift of each taxel's rest level at the start of each press [counts], shape (K, J).

    It is the mean of the idle frames directly before a press, minus the mean over all presses (minus 0 if the rest
    level has been subtracted). A James-Stein factor shrinks it by the fraction of its variance that the noise of these
    frames explains, so that no drift is corrected without a drift. It is 0 where it is unknown or the converter clips.

    Returns:
        The drift; None without idle frames between presses.
    """
    frames, presses = dataset.frames, dataset.presses
    if frames is None:
        return None
    idle = frames.phase == IDLE
    spans = _idle_before(idle, frames.press, presses.press)
    known = np.array([len(rows) > 1 for rows in spans])
    if known.sum() < _FEWEST:
        return None
    rows = [span for span in spans if len(span) > 1]
    number = np.array([len(span) for span in rows], dtype=np.float64)
    sensor, shifts = dataset.meta.sensor, np.zeros(presses.counts.shape)
    low = -np.inf if sensor.value_min is None or sensor.baseline == "subtracted" else sensor.value_min
    for j, counts in enumerate(frames.taxel_columns()):
        parts = [counts[some] for some in rows]
        mean = np.array([part.mean() for part in parts])
        noise = float(np.median([part.var(ddof=1) for part in parts]))
        if not np.isfinite(mean).all():
            continue
        middle = 0.0 if sensor.baseline == "subtracted" else float(mean.mean())
        variance = max(float(np.mean((mean - middle) ** 2)) - float(np.mean(noise / number)), 0.0)
        if variance > 0 and mean.min() > low + _CLEAR * np.sqrt(noise):
            shifts[known, j] = (mean - middle) * variance / (variance + noise / number)
    if sensor.value_max is not None and sensor.baseline != "subtracted":
        shifts[presses.counts >= sensor.value_max] = 0.0
    return shifts


def _idle_before(idle: BoolArray, press: IntArray, numbers: IntArray) -> list[NDArray[np.intp]]:
    """Return the rows of the uninterrupted idle frames directly before each press, at most ``NEAREST`` of them."""
    touched = np.flatnonzero(~idle)
    known, first = np.unique(press[touched], return_index=True)
    begins = dict(zip(known.tolist(), touched[first].tolist(), strict=True))
    spans: list[NDArray[np.intp]] = []
    for number in numbers.tolist():
        begin = begins.get(number, 0)
        part = idle[max(begin - NEAREST, 0) : begin]
        gaps = np.flatnonzero(~part)
        spans.append(np.arange(begin - len(part) + (int(gaps[-1]) + 1 if len(gaps) else 0), begin))
    return spans


@dataclass(frozen=True)
class Summary:
    """Summary of a dataset: numbers of presses, of frames, and of frames by phase.

    Attributes:
        sites: number of different targets, or None without targets.
        session_s: length of the session [s]; None without times.
        force_n: smallest, median and largest force of the presses [N].
        threshold_counts: threshold above the rest level from which a taxel is active [counts].
        active: ``active[n]`` is the number of presses with ``n`` active taxels.
        silent: taxels that are active in no press.
        dead: taxels that are NaN in every press.
        labels: number of presses by value, for each column such as branch or pose.
        columns: names of the other optional columns.
    """

    presses: int
    sites: int | None
    frames: int
    phases: Mapping[str, int]
    session_s: float | None
    force_n: tuple[float, float, float]
    threshold_counts: float
    active: tuple[int, ...]
    silent: tuple[str, ...]
    dead: tuple[str, ...]
    labels: Mapping[str, Mapping[str, int]]
    columns: tuple[str, ...]

    @property
    def usable(self) -> int:
        """Number of presses with at least two active taxels, as the fit requires."""
        return sum(self.active[2:])


LABELS = ("branch", "pose", "cycle", "speed_m_per_s", "indenter_radius_m")


def summarise(dataset: Dataset, threshold_counts: float = ACTIVE_COUNTS) -> Summary:
    """Return the summary of a dataset; a taxel is active above a threshold from its rest level [counts]."""
    presses, frames = dataset.presses, dataset.frames
    phases = () if frames is None else np.bincount(frames.phase, minlength=len(PHASES)).tolist()
    active, targets = active_taxels(dataset, threshold_counts), presses.vectors(TARGET)
    names = np.array(dataset.meta.sensor.taxel_columns())
    dead = np.asarray(np.isnan(presses.counts).all(axis=0))
    force = presses.force_n
    return Summary(
        presses=len(presses),
        sites=None if targets is None else len(np.unique(targets.round(6), axis=0)),
        frames=0 if frames is None else len(frames),
        phases=dict(zip(PHASES, phases, strict=False)),
        session_s=_session_s(dataset),
        force_n=(float(force.min()), float(np.median(force)), float(force.max())),
        threshold_counts=threshold_counts,
        active=tuple(np.bincount(active.sum(axis=1)).tolist()),
        silent=tuple(names[~active.any(axis=0) & ~dead].tolist()),
        dead=tuple(names[dead].tolist()),
        labels={name: _counted(presses.columns[name]) for name in LABELS if name in presses.columns},
        columns=tuple(name for name in presses.columns if name not in LABELS),
    )


def _session_s(dataset: Dataset) -> float | None:
    times = session_times_s(dataset) if dataset.frames is None else dataset.frames.time_s
    if times is None or not np.isfinite(times).any():
        return None
    return float(np.nanmax(times) - np.nanmin(times))


def _counted(column: NDArray[np.generic]) -> dict[str, int]:
    texts = [value if isinstance(value, str) else f"{value:g}" for value in column.tolist()]
    counted = Counter("not given" if text in ("", "nan") else text for text in texts)
    return dict(sorted(counted.items()))
