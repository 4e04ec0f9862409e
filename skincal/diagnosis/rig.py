"""What the rig that a dataset comes from can do, read off the dataset.

Further presses keep to what it has shown: its sites, its greatest force, its fastest loading, its hand poses and its
indenters. Slower loading, longer holds and smaller forces are always possible.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skincal.collect import FullProtocol, Mount, Plan, PlannedPress, read_plan
from skincal.collect.collection import PLAN
from skincal.covariates import TIMES
from skincal.dataset import Dataset
from skincal.dataset.placement import patch_coordinates
from skincal.diagnosis.dataset_session import pose_names
from skincal.errors import InputError
from skincal.model import TaxelLayout
from skincal.model.arrays import as_floats

Floats = NDArray[np.float64]

SLOWEST_M_PER_S, LONG_HOLD_S = 5e-4, 4.0
_FRAMES_HZ, _IDLE_S, _RAMP_S = 25.0, 2.0, 0.3
_LOW_N = 0.3
_STEP_M, _ROUNDING, _BEYOND_M, _LEAST_M = 5e-4, 1e-3, 2e-3, 2e-3


@dataclass(frozen=True)
class Rig:
    """How a dataset was pressed.

    Attributes:
        mount: surface, nominal pose and taxels.
        field: the rectangle of the patch that was pressed, as one large taxel.
        forces_n: least and greatest hold force to press with [N].
        speeds_m_per_s: slow and fast loading [m/s].
        holds_s: short and long hold [s].
        poses: names of the hand poses, by their numbers.
        angles_rad: of the joints in each pose, where the dataset's own plan says them.
        radii_m: radii of further indenters, beside the dataset's own [m].
        ramp: length of a loading: seconds, and seconds for each N s/m of force over speed.
        idle_s: from one press to the next [s].
        frame_rate_hz: of frames [Hz].
    """

    mount: Mount
    field: TaxelLayout
    forces_n: tuple[float, float]
    speeds_m_per_s: tuple[float, float]
    holds_s: tuple[float, float]
    poses: tuple[str, ...]
    angles_rad: Mapping[str, tuple[float, ...]]
    radii_m: tuple[float, ...]
    ramp: tuple[float, float]
    idle_s: float
    frame_rate_hz: float

    @classmethod
    def of(cls, dataset: Dataset) -> Rig:
        """Reads off a dataset how it was pressed; what was not recorded is as ``skincal collect`` does it."""
        mount = Mount(dataset.surface(), dataset.nominal_pose(), dataset.layout())
        force = dataset.presses.force_n[dataset.presses.force_n > 0]
        greatest = float(np.quantile(force, 0.98))
        return cls(
            mount,
            _field(dataset, mount),
            (min(_LOW_N, float(force.min())), greatest),
            _speeds(dataset),
            _holds(dataset),
            pose_names(dataset) or ("A",),
            _angles(dataset, mount),
            _further_radii(dataset),
            *_pace(dataset),
        )

    def plan(self, name: str, presses: Sequence[PlannedPress]) -> Plan:
        """A plan of presses, with the angles of their poses where all of them are known."""
        angles = {p.pose: self.angles_rad[p.pose] for p in presses if p.pose in self.angles_rad}
        known = all(p.pose in angles for p in presses)
        return Plan(name, tuple(presses), angles if known else {})

    def on_surface(self, presses: Sequence[PlannedPress]) -> list[PlannedPress]:
        """The presses whose sites lie on the surface: it may end within the field."""
        if not presses:
            return []
        points, _ = self.mount.place([p.site for p in presses])
        return [p for p, point in zip(presses, points, strict=True) if np.isfinite(point).all()]

    @property
    def usual(self) -> PlannedPress:
        """A press of middle force, fast, with a short hold, in the middle of what was pressed."""
        u, v = as_floats(self.field.centres_m[0]).tolist()
        force = round((self.forces_n[0] ** 0.5 / 2 + self.forces_n[1] ** 0.5 / 2) ** 2, 3)
        return PlannedPress(u, v, force, self.speeds_m_per_s[-1], self.holds_s[0], self.poses[0])


def _times(dataset: Dataset) -> Floats | None:
    """Start, hold, release and end (P, 4) [s] of presses; None where they were not recorded."""
    columns = [dataset.presses.column(name) for name in TIMES]
    given = [c for c in columns if c is not None]
    if len(given) < len(TIMES):
        return None
    times = np.stack(given, axis=1)
    return times if np.isfinite(times).all() else None


def _pace(dataset: Dataset) -> tuple[tuple[float, float], float, float]:
    """Length of a loading, time between presses [s] and frames in a second [Hz]."""
    times, speed = _times(dataset), dataset.presses.column("speed_m_per_s")
    ramp, idle, rate = (_RAMP_S, 0.0), _IDLE_S, _FRAMES_HZ
    if times is not None:
        loading = times[:, 1] - times[:, 0]
        ramp = (max(0.04, float(np.median(loading))), 0.0)
        if speed is not None and np.isfinite(speed).all() and (speed > 0).all():
            ratio = dataset.presses.force_n / speed
            slope, start = np.polyfit(ratio, loading, 1) if np.ptp(ratio) > 0 else (0.0, ramp[0])
            ramp = (max(0.04, float(start)), max(0.0, float(slope)))
        gaps = np.sort(times[:, 0])[1:] - np.sort(times[:, 3])[:-1]
        idle = float(np.clip(np.median(gaps), 0.2, 10.0)) if len(gaps) else idle
    if dataset.frames is not None:
        step = np.diff(dataset.frames.time_s)
        rate = float(1 / np.median(step[step > 0])) if (step > 0).any() else rate
    return ramp, idle, rate


def _angles(dataset: Dataset, mount: Mount) -> Mapping[str, tuple[float, ...]]:
    """Angles of the hand poses [rad] from the plan that ``skincal collect`` leaves beside a dataset; else none."""
    path = None if dataset.folder is None else dataset.folder / PLAN
    if path is None or not path.is_file():
        return {}
    try:
        return read_plan(path, mount).poses
    except InputError:  # another file of that name
        return {}


def _field(dataset: Dataset, mount: Mount) -> TaxelLayout:
    """The rectangle that presses were aimed at, in half millimetres, not far beyond the taxels."""
    sites = patch_coordinates(mount.surface, mount.pose, _aims(dataset))
    sites = sites[np.isfinite(sites).all(axis=1)]
    bounds = mount.layout.bounds_m
    low = as_floats(np.ceil(sites.min(axis=0) / _STEP_M - _ROUNDING) * _STEP_M)
    high = as_floats(np.floor(sites.max(axis=0) / _STEP_M + _ROUNDING) * _STEP_M)
    low, high = np.maximum(low, bounds[0] - _BEYOND_M), np.minimum(high, bounds[1] + _BEYOND_M)
    middle, side = as_floats((low + high) / 2 + 0.0), as_floats(np.maximum(high - low, _LEAST_M))
    return TaxelLayout(1, 1, np.round(middle, 6)[None], np.round(side, 6))


def _aims(dataset: Dataset) -> Floats:
    """Where presses were aimed at (P, 3) [m], else where they were measured: there the rig can get to."""
    targets = [dataset.presses.column(f"target_{axis}_m") for axis in "xyz"]
    given = [t for t in targets if t is not None and np.isfinite(t).any()]
    return np.stack(given, axis=1) if len(given) == len(targets) else dataset.presses.position_m


def _speeds(dataset: Dataset) -> tuple[float, float]:
    speed = dataset.presses.column("speed_m_per_s")
    known = np.zeros(0) if speed is None else speed[np.isfinite(speed) & (speed > 0)]
    slow, fast = FullProtocol().speeds_m_per_s
    if len(known):
        slow, fast = float(known.min()), float(known.max())
        slow = slow if fast > 2 * slow else slow / 4
    return _three_digits(max(slow, SLOWEST_M_PER_S)), _three_digits(max(fast, SLOWEST_M_PER_S))


def _holds(dataset: Dataset) -> tuple[float, float]:
    times = _times(dataset)
    short, long = FullProtocol().holds_s
    if times is not None:
        hold = times[:, 2] - times[:, 1]
        short, long = float(hold.min()), float(hold.max())
    return _three_digits(max(0.3, short)), _three_digits(min(60.0, max(long, LONG_HOLD_S)))


def _three_digits(value: float) -> float:
    return float(f"{value:.3g}")


def _further_radii(dataset: Dataset) -> tuple[float, ...]:
    """Radii of spheres beside the dataset's own [m], the most used first."""
    radii = dataset.indenter_radii_m()
    own = dataset.meta.indenter.radius_m
    if own is None or np.isnan(radii).all():
        return ()
    different, count = np.unique(np.round(radii[np.isfinite(radii)], 7), return_counts=True)
    return tuple(float(r) for r in different[np.argsort(-count)] if abs(r - own) > 1e-6)
