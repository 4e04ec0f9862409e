"""Infer the limits of the rig that a dataset comes from.

Further presses stay within what the dataset shows: its sites, largest force, fastest loading, hand poses and indenters.
Slower loading, longer holds and smaller forces are always possible.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from skincal.collect import FullProtocol, Mount, Plan, PlannedPress, read_plan
from skincal.collect.collection import PLAN
from skincal.collect.protocols import named_by_order
from skincal.dataset import Dataset
from skincal.dataset.placement import patch_coordinates
from skincal.errors import InputError
from skincal.model import TaxelLayout
from skincal.model.arrays import as_floats
from skincal.prediction.session_samples import pose_names, press_times

Floats = NDArray[np.float64]

SLOWEST_M_PER_S, LONG_HOLD_S = 5e-4, 4.0
"""Least loading speed [m/s], and length of the long hold where the dataset has only shorter ones [s]."""
_FRAMES_HZ, _IDLE_S, _RAMP_S = 25.0, 2.0, 0.3
"""Frame rate, time between presses and length of a loading where they were not recorded."""
_LOW_N, _HIGH_QUANTILE = 0.3, 0.98
"""Smallest hold force [N], and the quantile of the forces that is the largest one."""
_STEP_M, _ROUNDING, _BEYOND_M, _LEAST_M = 5e-4, 1e-3, 2e-3, 2e-3
"""Grid of the pressed area [m], its tolerance in grid steps, largest overhang over the taxels, and least side [m]."""


@dataclass(frozen=True)
class Rig:
    """Limits and timing of a rig.

    Attributes:
        mount: surface, nominal pose and taxels.
        pressed_area: rectangle of the patch that was pressed, as one large taxel.
        forces_n: smallest and largest hold force [N].
        speeds_m_per_s: slow and fast loading speed [m/s].
        holds_s: short and long hold [s].
        poses: names of the hand poses, by their numbers.
        angles_rad: joint angles of each pose [rad], if the plan of the dataset gives them.
        radii_m: radii of further indenters than that of the dataset [m].
        ramp: length of a loading as a line in force over speed: intercept [s] and slope [m/N].
        idle_s: time from one press to the next [s].
        frame_rate_hz: frame rate [Hz].
    """

    mount: Mount
    pressed_area: TaxelLayout
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
        """Infer the rig from a dataset; what was not recorded is as in ``skincal collect``."""
        mount = Mount(dataset.surface(), dataset.nominal_pose(), dataset.layout())
        force = dataset.presses.force_n[dataset.presses.force_n > 0]
        largest = float(np.quantile(force, _HIGH_QUANTILE))
        return cls(
            mount,
            _pressed_area(dataset, mount),
            (min(_LOW_N, float(force.min())), largest),
            _speeds(dataset),
            _holds(dataset),
            pose_names(dataset) or ("A",),
            _angles(dataset, mount),
            _further_radii(dataset),
            *_pace(dataset),
        )

    def plan_session(self, presses: Sequence[PlannedPress]) -> Plan:
        """Return a session: an anchor, presses with the first indenter, an anchor, and presses with further indenters.

        The plan has the joint angles of the poses if all of them are known.
        """
        anchor = replace(self.usual, kind="anchor")
        first = [p for p in presses if p.indenter_radius_m is None]
        further = [p for p in presses if p.indenter_radius_m is not None]
        named = named_by_order([anchor, *first, anchor, *further])
        for k in (0, len(first) + 1):
            named[k] = replace(named[k], kind="anchor")
        angles = {p.pose: self.angles_rad[p.pose] for p in named if p.pose in self.angles_rad}
        return Plan("next-presses", tuple(named), angles if all(p.pose in angles for p in named) else {})

    def on_surface(self, presses: Sequence[PlannedPress]) -> list[PlannedPress]:
        """Return the presses whose sites lie on the surface, which may end within the pressed area."""
        if not presses:
            return []
        points, _ = self.mount.place([p.site for p in presses])
        return [p for p, point in zip(presses, points, strict=True) if np.isfinite(point).all()]

    @property
    def usual(self) -> PlannedPress:
        """A fast press of medium force and short hold, in the middle of the pressed area."""
        u, v = as_floats(self.pressed_area.centres_m[0]).tolist()
        force = round((self.forces_n[0] ** 0.5 / 2 + self.forces_n[1] ** 0.5 / 2) ** 2, 3)
        return PlannedPress(u, v, force, self.speeds_m_per_s[-1], self.holds_s[0], self.poses[0])


def _times(dataset: Dataset) -> Floats | None:
    """Return start, hold, release and end (P, 4) [s] of the presses; None if they were not recorded."""
    columns, known = press_times(dataset)
    return as_floats(np.stack(columns, axis=1)) if known else None


def _pace(dataset: Dataset) -> tuple[tuple[float, float], float, float]:
    """Return the length of a loading (:attr:`Rig.ramp`), the time between presses [s] and the frame rate [Hz]."""
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
    """Return the joint angles of the hand poses [rad] from the plan that ``skincal collect`` writes; {} without it."""
    path = None if dataset.folder is None else dataset.folder / PLAN
    if path is None or not path.is_file():
        return {}
    try:
        return read_plan(path, mount).poses
    except InputError:  # another file of that name
        return {}


def _pressed_area(dataset: Dataset, mount: Mount) -> TaxelLayout:
    """Return the rectangle of the target positions on a grid of half a millimetre, at most 2 mm beyond the taxels."""
    sites = patch_coordinates(mount.surface, mount.pose, _target_positions(dataset))
    sites = sites[np.isfinite(sites).all(axis=1)]
    bounds = mount.layout.bounds_m
    low = as_floats(np.ceil(sites.min(axis=0) / _STEP_M - _ROUNDING) * _STEP_M)
    high = as_floats(np.floor(sites.max(axis=0) / _STEP_M + _ROUNDING) * _STEP_M)
    low, high = np.maximum(low, bounds[0] - _BEYOND_M), np.minimum(high, bounds[1] + _BEYOND_M)
    middle, side = as_floats((low + high) / 2 + 0.0), as_floats(np.maximum(high - low, _LEAST_M))
    return TaxelLayout(1, 1, np.round(middle, 6)[None], np.round(side, 6))


def _target_positions(dataset: Dataset) -> Floats:
    """Return the target positions (P, 3) [m] of the presses, or the measured ones if there are no targets."""
    targets = [dataset.presses.column(f"target_{axis}_m") for axis in "xyz"]
    recorded = [t for t in targets if t is not None and np.isfinite(t).any()]
    return np.stack(recorded, axis=1) if len(recorded) == len(targets) else dataset.presses.position_m


def _speeds(dataset: Dataset) -> tuple[float, float]:
    """Return a slow and a fast loading speed [m/s]."""
    speed = dataset.presses.column("speed_m_per_s")
    known = np.zeros(0) if speed is None else speed[np.isfinite(speed) & (speed > 0)]
    slow, fast = FullProtocol().speeds_m_per_s
    if len(known):
        slow, fast = float(known.min()), float(known.max())
        slow = slow if fast > 2 * slow else slow / 4
    return _three_digits(max(slow, SLOWEST_M_PER_S)), _three_digits(max(fast, SLOWEST_M_PER_S))


def _holds(dataset: Dataset) -> tuple[float, float]:
    """Return a short and a long hold [s]."""
    times = _times(dataset)
    short, long = FullProtocol().holds_s
    if times is not None:
        hold = times[:, 2] - times[:, 1]
        short, long = float(hold.min()), float(hold.max())
    return _three_digits(max(0.3, short)), _three_digits(min(60.0, max(long, LONG_HOLD_S)))


def _three_digits(value: float) -> float:
    return float(f"{value:.3g}")


def _further_radii(dataset: Dataset) -> tuple[float, ...]:
    """Return the radii of the spheres other than the dataset's own [m], most frequent first."""
    radii = dataset.indenter_radii_m()
    own = dataset.meta.indenter.radius_m
    if own is None or np.isnan(radii).all():
        return ()
    different, count = np.unique(np.round(radii[np.isfinite(radii)], 7), return_counts=True)
    return tuple(float(r) for r in different[np.argsort(-count)] if abs(r - own) > 1e-6)
