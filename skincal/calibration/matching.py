"""Checks that data, or a hand, have the sensor of a calibration."""

from __future__ import annotations

from collections.abc import Mapping
from math import degrees, inf, isfinite

import numpy as np

from skincal.calibration.calibration import Calibration
from skincal.dataset import Dataset, SensorSpec, SurfaceSpec
from skincal.errors import InputError, Problem
from skincal.model import TaxelLayout

SAME_M = 1e-6
"""Tolerance within which lengths are equal [m]."""

_FIX = "Use a calibration of this sensor."


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
        found = _mount(calibration, dataset, file)
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
    return [
        *_taxels(calibration, sensor, layout, place),
        *_converter(calibration.sensor, sensor, place),
        *_surface(calibration, surface, meshes, place),
    ]


def _taxels(calibration: Calibration, sensor: SensorSpec, layout: TaxelLayout, place: str) -> list[Problem]:
    ours = calibration.sensor
    if (ours.rows, ours.cols) != (sensor.rows, sensor.cols):
        expected = f"{ours.rows} x {ours.cols} taxels, as the calibration has"
        return [Problem(f"{place}, [sensor]", expected, f"{sensor.rows} x {sensor.cols}", _FIX)]
    own = calibration.layout()
    off = max(np.abs(own.centres_m - layout.centres_m).max(), np.abs(own.sizes_m - layout.sizes_m).max())
    if off <= SAME_M:
        return []
    expected = "the calibrated positions of the taxels"
    return [Problem(f"{place}, [sensor]", expected, f"taxels up to {1e3 * off:.3g} mm off", _FIX)]


def _converter(ours: SensorSpec, other: SensorSpec, place: str) -> list[Problem]:
    """Return differences of the converter's bounds, where both are known: another converter has other counts."""
    pairs = [(name, getattr(ours, name), getattr(other, name)) for name in ("value_min", "value_max")]
    return [
        Problem(f"{place}, [sensor] {name}", f"{mine:g} counts, as calibrated", f"{its:g}", _FIX)
        for name, mine, its in pairs
        if mine is not None and its is not None and mine != its
    ]


def _surface(
    calibration: Calibration, other: SurfaceSpec, meshes: Mapping[str, bytes], place: str
) -> list[Problem]:
    mine = calibration.surface
    if mine.kind != other.kind:
        expected, got = f'"{mine.kind}", as calibrated', f'"{other.kind}"'
        return [Problem(f"{place}, [surface] kind", expected, got, _FIX)]
    its = other.numbers
    for key, own in mine.numbers.items():
        if abs(own - its[key]) > SAME_M:
            return [
                Problem(f"{place}, [surface] {key}", f"{own:g} m, as calibrated", f"{its[key]:g} m", _FIX)
            ]
    if mine.file and other.file and calibration.meshes.get(mine.file) != meshes.get(other.file):
        return [
            Problem(f"{place}, [surface] file", "the calibrated mesh", f"another one, {other.file}", _FIX)
        ]
    return []


def _mount(calibration: Calibration, dataset: Dataset, place: str) -> list[Problem]:
    """Return ranges of the mount that exclude the calibrated pose, allowing for the slack of positions."""
    mount, slack = dataset.meta.mount, dataset.meta.position.slack_m
    if not isfinite(slack):
        return []
    radius = calibration.surface_model().arc_radius_at(calibration.pose())
    ranges = {
        "y_m": (mount.y_range_m, slack),
        "x_m": (mount.x_range_m, slack),
        "beta_deg": (mount.beta_range_deg, degrees(slack / radius) if radius else inf),
        "alpha_deg": (mount.alpha_range_deg, 0.0),
    }
    found: list[Problem] = []
    for name, best in calibration.model.best().items():
        searched, beside = ranges.get(name, (None, 0.0))
        if searched is None:
            continue
        low, high = calibration.intervals.get(name, (best, best))
        if high < searched[0] - beside or low > searched[1] + beside:
            key = name.replace("_m", "_range_m").replace("_deg", "_range_deg")
            expected = f"a range with the calibrated {name} in it, {best:.4g}"
            got = f"{searched[0]:g} to {searched[1]:g}"
            found.append(Problem(f"{place}, [mount] {key}", expected, got, _FIX))
    return found
