"""Uniform pressure: a pressure chamber, described as a flat punch larger than the patch, on a flat sensor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skincal.dataset.dataset import Dataset
from skincal.model import FlatPunch
from skincal.model.arrays import FloatArray

FLAT_M = 20e-6
"""Largest deviation of a flat patch from its tangent plane [m]: far less than the depth of a press."""

UNIFORM = (
    "every press is a flat punch larger than the flat patch: such uniform pressure looks the same for every pose and "
    "every elasticity, so it determines neither. Press with an indenter smaller than the patch (a sphere of "
    "about one pitch in radius) at several places. The scale of each taxel can be fitted"
)


def uniform_pressure(dataset: Dataset) -> bool:
    """Return whether every press loads all taxels equally: the sensor is flat, and a flat punch covers it.

    On a curved surface a plate touches along a line or at a point, and is an ordinary contact.
    """
    if dataset.meta.indenter.kind != "flat":
        return False
    radii = dataset.indenter_radii_m()
    known = np.unique(radii[np.isfinite(radii)])
    punches = [dataset.indenter(float(r)) for r in known] if len(known) else [dataset.indenter()]
    half = float(np.hypot(*np.abs(dataset.layout().bounds_m).max(axis=0)))
    if not all(isinstance(one, FlatPunch) and one.radius_m > half for one in punches):
        return False
    flat, centre = _flat_patch(dataset)
    if not flat or centre is None:
        return flat
    # A punch whose edge crosses the patch loads it unevenly; an unknown position counts as centred.
    apart = np.linalg.norm(dataset.presses.position_m - centre, axis=1)
    own = dataset.meta.indenter.radius_m
    radius = np.where(np.isfinite(radii), radii, np.inf if own is None else own)
    return bool((np.nan_to_num(apart) + half <= radius).all())


def _flat_patch(dataset: Dataset) -> tuple[bool, FloatArray | None]:
    """Return whether the taxels lie in a plane, and their nominal centre if positions are known."""
    surface, bounds = dataset.surface(), dataset.layout().bounds_m
    known = bool(np.isfinite(dataset.meta.position.sigma_m))
    axes = [np.linspace(float(low), float(high), 5) for low, high in bounds.T]
    corners = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    try:
        points, _ = surface.wrap(dataset.nominal_pose(), corners)
        centre, normal = surface.wrap(dataset.nominal_pose(), np.zeros((1, 2)))
    except ValueError:
        return dataset.meta.surface.is_plane, None
    off = np.abs((points - centre) @ normal[0])
    return bool(np.isfinite(off).all() and off.max() <= FLAT_M), centre[0] if known else None


def notes_on(dataset: Dataset) -> tuple[str, ...]:
    """Return notes on the limits of a valid dataset."""
    return (f"{UNIFORM}.",) if uniform_pressure(dataset) else ()


def zero_load_levels(dataset: Dataset) -> FloatArray:
    """Return the rest level of each taxel (J,) [counts]: a line fitted to counts over force, extrapolated to no force.

    NaN for a taxel with fewer than three readings within the converter's range.
    """
    counts, force = dataset.presses.counts, dataset.presses.force_n
    sensor = dataset.meta.sensor
    within = np.isfinite(counts) & np.isfinite(force)[:, None]
    if sensor.value_max is not None and sensor.baseline == "raw":
        within &= counts < sensor.value_max
    levels = np.full(counts.shape[1], np.nan)
    for j, own in enumerate(counts.T):
        ok = within[:, j]
        if ok.sum() > 2 and np.ptp(force[ok]) > 0:
            levels[j] = np.polynomial.polynomial.polyfit(force[ok], own[ok], 1)[0]
    return levels


RADIUS = "indenter_radius_m"


def centre_contacts(dataset: Dataset, margin_m: float) -> Dataset:
    """Adapt the contacts of a pressure chamber to the modelled skin; return any other dataset unchanged.

    ``force_n`` of a chamber is the pressure times the area of its punch, but the modelled skin ends a margin [m] beyond
    its taxels. Contacts of unknown position move to the sensor's nominal centre, the punch is enlarged to cover the
    whole modelled skin, and forces become the pressure times the area of that skin.
    """
    if not uniform_pressure(dataset):
        return dataset
    centre = dataset.surface().wrap(dataset.nominal_pose(), np.zeros((1, 2)))[0][0]

    def placed(points: FloatArray) -> FloatArray:
        return np.where(np.isfinite(points), points, centre)

    presses, indenter = dataset.presses, dataset.meta.indenter
    sides = np.ptp(dataset.layout().bounds_m, axis=0) + 2 * margin_m
    share = float(np.prod(sides)) / (np.pi * dataset.indenter_radii_m() ** 2)
    apart = float(np.linalg.norm(placed(presses.position_m) - centre, axis=1).max(initial=0.0))
    # The radius is twice what covers the skin at its nominal pose, so that the pressure stays even at other poses.
    meta = replace(dataset.meta, indenter=replace(indenter, radius_m=float(np.hypot(*sides)) + apart))
    frames = dataset.frames
    if frames is not None:
        # Scale all frames with the median over the presses; frames outside presses have no force.
        frames = frames.moved(placed(frames.position_m), frames.force_n * float(np.median(share)))
        if RADIUS in frames.columns:
            frames = replace(frames, columns={k: v for k, v in frames.columns.items() if k != RADIUS})
    presses = replace(
        presses,
        position_m=placed(presses.position_m),
        force_n=presses.force_n * share,
        columns={k: v for k, v in presses.columns.items() if k != RADIUS},
    )
    return replace(dataset, meta=meta, presses=presses, frames=frames)
