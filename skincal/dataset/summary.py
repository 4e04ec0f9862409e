"""A summary of a dataset in a few numbers."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skincal.covariates import TARGET
from skincal.dataset.dataset import Dataset
from skincal.dataset.rest import ACTIVE_COUNTS, active_taxels
from skincal.dataset.tables import PHASES
from skincal.model.arrays import FloatArray


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
"""Columns whose values are counted."""


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


def session_times_s(dataset: Dataset) -> FloatArray | None:
    """Return the time of each press: the middle of its hold, or its start [s], shape (K,); None if unknown."""
    column = dataset.presses.column
    hold, release = column("t_hold_s"), column("t_release_s")
    if hold is not None and release is not None:
        return (hold + release) / 2
    return column("t_start_s") if hold is None else hold


def _session_s(dataset: Dataset) -> float | None:
    times = session_times_s(dataset) if dataset.frames is None else dataset.frames.time_s
    if times is None or not np.isfinite(times).any():
        return None
    return float(np.nanmax(times) - np.nanmin(times))


def _counted(column: NDArray[np.generic]) -> dict[str, int]:
    texts = [value if isinstance(value, str) else f"{value:g}" for value in column.tolist()]
    counted = Counter("not given" if text in ("", "nan") else text for text in texts)
    return dict(sorted(counted.items()))
