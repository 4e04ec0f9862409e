"""Uniform pressure: a pressure chamber, described as a flat punch larger than the patch, on a flat sensor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skincal.dataset.dataset import Dataset
from skincal.model import FlatPunch

FLAT_M = 20e-6
"""A patch is flat if it leaves its tangent plane by no more than this [m]: far less than the depth of a press."""

UNIFORM = (
    "every press is a flat punch larger than the flat patch: such uniform pressure looks the same for every pose and "
    "every elasticity, so it determines neither. Press with an indenter smaller than the patch (a sphere of "
    "about one pitch in radius) at several places. The scale of each taxel can be fitted"
)
"""Limits of uniform pressure, and advice."""


def uniform_pressure(dataset: Dataset) -> bool:
    """Return whether every press loads all taxels equally: the sensor is flat, and a flat punch covers it.

    On a curved surface a plate touches along a line or at a spot, and is a contact like any other.
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
    # A punch whose edge crosses the patch loads it unevenly, as far as its position is known.
    apart = np.linalg.norm(dataset.presses.position_m - centre, axis=1)
    own = dataset.meta.indenter.radius_m
    radius = np.where(np.isfinite(radii), radii, np.inf if own is None else own)
    return bool((np.nan_to_num(apart) + half <= radius).all())


def _flat_patch(dataset: Dataset) -> tuple[bool, np.ndarray | None]:
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
    """Return the limits of data that have no faults."""
    return (f"{UNIFORM}.",) if uniform_pressure(dataset) else ()


def borne(dataset: Dataset, margin_m: float) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Return the part of each press's force (P,) that a modelled skin bears.

    ``force_n`` of a chamber is the pressure times the area of its punch. A modelled skin ends a margin beyond its
    taxels, so that the rest of the punch presses outside the model. The part is 1 for all other presses.

    Args:
        dataset: a dataset.
        margin_m: margin of the modelled skin beyond the taxels [m].
    """
    whole = np.ones(len(dataset.presses))
    if not (uniform_pressure(dataset) and dataset.meta.surface.is_plane):
        return whole
    low, high = dataset.layout().bounds_m
    skin_m2 = float(np.prod(high - low + 2 * margin_m))
    radii = dataset.indenter_radii_m()
    own = dataset.meta.indenter.radius_m
    return skin_m2 / (np.pi * np.where(np.isfinite(radii), radii, np.nan if own is None else own) ** 2)


def at_centre(dataset: Dataset, margin_m: float) -> Dataset:
    """Return the dataset of a chamber with the contacts that a modelled skin bears.

    Contacts of unknown position move to the sensor's nominal centre, and forces become what the skin bears of them
    (:func:`borne`).

    Args:
        dataset: a dataset of uniform pressure.
        margin_m: margin of the modelled skin beyond the taxels [m].
    """
    centre = dataset.surface().wrap(dataset.nominal_pose(), np.zeros((1, 2)))[0][0]

    def placed(points: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> np.ndarray:
        return np.where(np.isfinite(points), points, centre)

    presses, share = dataset.presses, borne(dataset, margin_m)
    frames = dataset.frames
    if frames is not None:
        # One punch stands for the pressure of all frames; frames outside presses have no force.
        force = frames.force_n * float(np.median(share))
        frames = frames.moved(placed(frames.position_m), force)
    presses = replace(presses, position_m=placed(presses.position_m), force_n=presses.force_n * share)
    return replace(dataset, presses=presses, frames=frames)
