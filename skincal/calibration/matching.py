"""Check that data, or a hand, have the sensor of a calibration."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from math import degrees, inf, isfinite

import numpy as np

from skincal.calibration.calibration import Calibration
from skincal.dataset import Dataset, SensorSpec, SurfaceSpec
from skincal.errors import InputError, Problem
from skincal.model import TaxelLayout

SAME_M = 1e-6
"""Tolerance within which lengths are equal [m]."""

_FIX = "Use a calibration of this sensor."
"""Advice if sensors differ."""


def check_same_sensor(calibration: Calibration, dataset: Dataset) -> None:
    """Check that a dataset has the calibrated sensor and surface, and that its mount allows the calibrated pose.

    Raises:
        InputError: they differ; the message lists all differences.
    """
    file = "dataset.toml" if dataset.folder is None else str(dataset.folder / "dataset.toml")
    meta = dataset.meta
    found = sensor_differences(
        calibration, meta.sensor, dataset.layout(), meta.surface, dataset.meshes, place=file
    )
    fitted_to_it = bool(dataset.sha256) and calibration.provenance.dataset_sha256 == dataset.sha256
    if not found and not fitted_to_it:
        found = [
            Problem(f"{file}, {key}", expected, got, _FIX)
            for key, expected, got in _mount(calibration, dataset)
        ]
    if found:
        raise InputError(found)


def sensor_differences(
    calibration: Calibration,
    sensor: SensorSpec,
    layout: TaxelLayout,
    surface: SurfaceSpec,
    meshes: Mapping[str, bytes],
    *,
    place: str,
) -> list[Problem]:
    """Return every difference of a sensor from the calibrated one."""
    found = [
        *_taxels(calibration, sensor, layout),
        *_converter(calibration.sensor, sensor),
        *_surface(calibration, surface, meshes),
    ]
    return [Problem(f"{place}, {key}", expected, got, _FIX) for key, expected, got in found]


_Difference = tuple[str, str, str]
"""Key, expected value, and actual value."""


def _taxels(calibration: Calibration, sensor: SensorSpec, layout: TaxelLayout) -> Iterator[_Difference]:
    """Yield differences of the number and the positions of taxels."""
    ours, own = calibration.sensor, calibration.layout()
    if (ours.rows, ours.cols) != (sensor.rows, sensor.cols):
        expected = f"{ours.rows} x {ours.cols} taxels, as the calibration has"
        yield "[sensor]", expected, f"{sensor.rows} x {sensor.cols}"
        return
    off = max(np.abs(own.centres_m - layout.centres_m).max(), np.abs(own.sizes_m - layout.sizes_m).max())
    if off > SAME_M:
        yield "[sensor]", "the calibrated positions of the taxels", f"taxels up to {1e3 * off:.3g} mm off"


def _converter(ours: SensorSpec, other: SensorSpec) -> Iterator[_Difference]:
    """Yield differences of the converter's bounds, where both are known: another converter has other counts."""
    for name in ("value_min", "value_max"):
        mine, its = getattr(ours, name), getattr(other, name)
        if mine is not None and its is not None and mine != its:
            yield f"[sensor] {name}", f"{mine:g} counts, as calibrated", f"{its:g}"


def _surface(
    calibration: Calibration, other: SurfaceSpec, meshes: Mapping[str, bytes]
) -> Iterator[_Difference]:
    """Yield the first difference of the surface."""
    mine = calibration.surface
    if mine.kind != other.kind:
        yield "[surface] kind", f'"{mine.kind}", as calibrated', f'"{other.kind}"'
        return
    for key, own in mine.numbers.items():
        if abs(own - other.numbers[key]) > SAME_M:
            yield f"[surface] {key}", f"{own:g} m, as calibrated", f"{other.numbers[key]:g} m"
            return
    if mine.file and other.file and calibration.meshes.get(mine.file) != meshes.get(other.file):
        yield "[surface] file", "the calibrated mesh", f"another one, {other.file}"


def _mount(calibration: Calibration, dataset: Dataset) -> Iterator[_Difference]:
    """Yield ranges of the mount that exclude the calibrated pose, allowing for the slack of positions."""
    mount, slack = dataset.meta.mount, dataset.meta.position.slack_m
    if not isfinite(slack):
        return
    radius = calibration.surface_model().arc_radius_at(calibration.pose())
    ranges = {
        "y_m": (mount.y_range_m, slack),
        "x_m": (mount.x_range_m, slack),
        "beta_deg": (mount.beta_range_deg, degrees(slack / radius) if radius else inf),
        "alpha_deg": (mount.alpha_range_deg, 0.0),
    }
    for name, best in calibration.model.best().items():
        searched, beside = ranges.get(name, (None, 0.0))
        if searched is None:
            continue
        low, high = calibration.intervals.get(name, (best, best))
        if high < searched[0] - beside or low > searched[1] + beside:
            key = name.replace("_m", "_range_m").replace("_deg", "_range_deg")
            expected = f"a range with the calibrated {name} in it, {best:.4g}"
            yield f"[mount] {key}", expected, f"{searched[0]:g} to {searched[1]:g}"
