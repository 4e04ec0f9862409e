"""Plausibility checks: well-formed values that cannot be intended, above all a unit off by a factor of 1000.

A quantity is wrong only if its *median* is implausible: single presses may be outliers.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from skincal.covariates import POSITION, TARGET
from skincal.dataset.columns import JOINT
from skincal.dataset.dataset import Dataset
from skincal.dataset.findings import Sheet, listed
from skincal.dataset.keys import MILLIMETRES, TWICE
from skincal.dataset.placement import SMALLEST_M, sample_noise_m, slide_m
from skincal.dataset.tables import HOLD, IDLE, Frames
from skincal.dataset.unit_checks import (
    CODE,
    FORCE_BEYOND_DOUBT_N,
    any_of,
    check_values,
    column_medians,
    force_units,
    length_factor,
    length_unit,
    scaled_by,
    unit_of_ratio,
)
from skincal.errors import first_of
from skincal.model.arrays import BoolArray, FloatArray

if TYPE_CHECKING:
    from skincal.model import Surface


HIGHEST_PRESSURE_PA = 3e6
LOWEST_PRESSURE_PA = 100.0
"""Mean pressures under the indenter outside which a median force is not in newtons."""

WHICH_FRAME = "Is the surface in dataset.toml the right one, and are the points in the fingertip frame?"

FAR, OUT_OF_REACH = 20.0, 3.0
"""Positions cannot be meant if their median is farther from the patch than this many times its reach. Beyond the second
no press touches the patch: another unit is looked for, in which they do."""

DROPPED, MOST_DROPPED = 1 / 3, 0.01
"""A frame of a hold has lost its force below this part of the hold's mean; this part of the frames may."""

MOST_POINTS = 100_000
"""Number of contact points of frames that are checked: a sample suffices for medians."""

APART_M, APART_SHARE, APART_IMAGE, FEWEST_COMPARED = 1e-3, 0.2, 0.7, 3
"""Frames belong to another press than the table's if their place is off by this [m], or their force is, and their
image by this part of the press's own; reported if at least this many presses are affected."""

LARGEST_RADIUS_M, SMALLEST_RADIUS_M = 1.0, 5e-5
FASTEST_M_PER_S = 0.5
LARGEST_ANGLE_RAD = 2 * np.pi


def check_plausible(dataset: Dataset, sheet: Sheet, frame_sheet: Sheet | None) -> None:
    """Report implausible values of well-formed data in the findings of the sheets of presses and frames."""
    presses, frames, surface = dataset.presses, dataset.frames, dataset.surface()
    _check_positions(dataset, surface, presses.position_m, sheet, POSITION)
    targets = presses.vectors(TARGET)
    if targets is not None:
        _check_positions(dataset, surface, targets, sheet, TARGET)
    _check_forces(dataset, sheet)
    _check_covariates(dataset, sheet)
    check_values(dataset, sheet, frame_sheet)
    if frames is not None and frame_sheet is not None:
        touching = np.flatnonzero(frames.phase != IDLE)
        touched = frames.position_m[touching[:: max(len(touching) // MOST_POINTS, 1)]]
        _check_positions(dataset, surface, touched, frame_sheet, POSITION)
        _check_frames(dataset, frames, frame_sheet)


def check_scale(points: FloatArray, sheet: Sheet) -> None:
    """Check contact points without a description, and so without a surface."""
    size = _median(np.linalg.norm(points, axis=1))
    if size > 1.0:
        fix, details = (MILLIMETRES, {"code": CODE, "factor": 1e-3}) if size < 1000.0 else ("", {})
        got = f"a median distance of {size:.3g} m"
        sheet.findings.error(sheet.column(*POSITION), "contact points [m]", got, fix, **details)


def _check_positions(
    dataset: Dataset, surface: Surface, points: FloatArray, sheet: Sheet, columns: tuple[str, ...]
) -> None:
    points = points[np.isfinite(points).all(axis=1)]
    if not len(points):
        return
    place, findings = sheet.column(*columns), sheet.findings
    centre = surface.wrap(dataset.nominal_pose(), np.zeros((1, 2)))[0]
    reach = patch_reach_m(dataset)
    away = float(np.median(np.linalg.norm(points - centre, axis=1)))
    unit = length_unit(dataset, points, centre[0], reach) if away > OUT_OF_REACH * reach else None
    if away > FAR * reach or unit is not None:
        wrong = np.median(np.abs(points - centre), axis=0) > reach
        if wrong.sum() == 1:
            place = sheet.column(columns[int(wrong.argmax())])
        fix, details, got = WHICH_FRAME, dict[str, Any](), f"a median distance of {away:.3g} m"
        if unit is not None:
            fix = f"It looks like {unit[0]}; the file is in metres: {scaled_by(unit[1])}."
            details = {"code": CODE, "factor": unit[1]}
        findings.error(place, "contact points [m] near the patch", got, fix, **details)
        return
    factor = length_factor(dataset, points, centre[0], reach)
    if factor is not None:
        got, fix = (
            f"others, at a median distance of {away:.3g} m",
            f"Are they in another unit? Then {scaled_by(factor)}.",
        )
        findings.warn(place, "contact points [m] that go with the images", got, fix, code=CODE, factor=factor)
    off = _median_off(surface, points)
    allowed = dataset.meta.position.slack_m + 3 * dataset.meta.position.sigma_m
    if not np.isfinite(allowed) or off <= max(allowed, 1e-4):
        return
    if _median_off(surface, points * 1000) <= max(allowed, 1e-4):
        got = f"a median of {off:.3g} m off it"
        findings.error(place, "contact points [m] on the surface", got, TWICE, code=CODE, factor=1000.0)
        return
    expected = f"contact points on the surface, within slack_m + 3 sigma_m = {allowed:.3g} m"
    findings.warn(place, expected, f"a median of {off:.3g} m off it", WHICH_FRAME)


def _median_off(surface: Surface, points: FloatArray) -> float:
    """Return the median distance from the surface [m], of a sample if there are many points."""
    points = points[:: max(len(points) // 200, 1)]
    return float(np.median(np.linalg.norm(points - surface.project(points), axis=1)))


def patch_reach_m(dataset: Dataset) -> float:
    """Return the largest distance from the nominal centre of a press that touches the patch [m]."""
    mount = dataset.meta.mount
    ranges = [r for r in (mount.y_range_m, mount.x_range_m) if r is not None]
    search = max((high - low for low, high in ranges), default=0.0)
    radii = dataset.indenter_radii_m()
    indenter = float(np.median(radii[np.isfinite(radii)])) if np.isfinite(radii).any() else 0.01
    corner = float(np.linalg.norm(dataset.layout().bounds_m, axis=1).max())
    sigma = dataset.meta.position.sigma_m
    return corner + search + indenter + (3 * sigma if np.isfinite(sigma) else 0.0)


def pressed_area_m2(dataset: Dataset) -> float:
    """Return the largest area that the indenter can press on [m²]: its own, or the patch if that is smaller.

    A flat punch on a plane may stand for uniform pressure: then its own area counts.
    """
    low, high = dataset.layout().bounds_m
    patch = float(np.prod(high - low))
    radii = dataset.indenter_radii_m()
    if not np.isfinite(radii).any():
        return patch
    own = float(np.pi * np.median(radii[np.isfinite(radii)]) ** 2)
    everywhere = dataset.meta.indenter.kind == "flat" and dataset.meta.surface.is_plane
    return own if everywhere else min(own, patch)


def _check_forces(dataset: Dataset, sheet: Sheet) -> None:
    place, findings = sheet.column("force_n"), sheet.findings
    median, area = _median(dataset.presses.force_n), pressed_area_m2(dataset)
    pressure = median / area
    got = f"a median of {median:.3g} N, {pressure:.2g} Pa under the indenter"
    if median <= 0:
        fix = "Forces on the skin are positive: set sign = -1 in the mapping."
        if median == 0:
            fix = "Is the right column mapped, and the zero of the force that of no contact?"
            findings.error(place, "positive normal forces [N]", got, fix)
        else:
            findings.error(place, "positive normal forces [N]", got, fix, code=CODE, factor=-1.0)
        return
    units = force_units(median, area)
    if not units:
        return
    factor = next(iter(units.values()))
    details = {"code": CODE, "factor": factor, "units": units}
    too_high = pressure > HIGHEST_PRESSURE_PA and median > FORCE_BEYOND_DOUBT_N
    if too_high or pressure < LOWEST_PRESSURE_PA:
        findings.error(place, "forces [N]", got, f"It looks like {any_of(units)}.", **details)
        return
    say = findings.warn if pressure > 1 and factor < 1 else findings.note
    say(place, "forces [N] that are plausible on a skin", got, f"Is it in {any_of(units)}?", **details)


def _check_covariates(dataset: Dataset, sheet: Sheet) -> None:
    place, findings, presses = sheet.column, sheet.findings, dataset.presses
    radius = _median(presses.column("indenter_radius_m"))
    if radius > LARGEST_RADIUS_M or radius < SMALLEST_RADIUS_M:
        fix = MILLIMETRES if radius > LARGEST_RADIUS_M else TWICE
        findings.error(place("indenter_radius_m"), "radii [m]", f"a median of {radius:.3g} m", fix)
    speed = _median(presses.column("speed_m_per_s"))
    if speed > FASTEST_M_PER_S:
        fix = "It looks like millimetres per second; divide by 1000."
        findings.error(place("speed_m_per_s"), "speeds of a press [m/s]", f"a median of {speed:.3g} m/s", fix)
    median = _median(presses.force_n)
    target = _median(presses.column("target_force_n"))
    if target > 100 * median > 0:
        got = f"a median of {target:.3g} N where {median:.3g} N were measured"
        name, factor = unit_of_ratio(target / median) or ("millinewtons", 1e-3)
        fix = f"It looks like {name}; {scaled_by(factor)}."
        findings.error(place("target_force_n"), "forces [N]", got, fix, code=CODE, factor=factor)
    elif target > 0 and median > 0 and (unit := unit_of_ratio(median / target)) is not None:
        got = f"a median of {median:.3g} N where {target:.3g} N were commanded"
        fix = f"Is force_n in {unit[0]}? Then {scaled_by(unit[1])}."
        findings.warn(place("force_n"), "forces [N]", got, fix, code=CODE, factor=unit[1])
    for name in ("shear_u_n", "shear_v_n"):
        column = presses.column(name)
        shear = 0.0 if column is None else _median(np.abs(column))
        if shear > 30 * median > 0:
            got = f"a median of {shear:.3g} N under a normal force of {median:.3g} N"
            findings.error(place(name), "forces [N]", got, "It looks like millinewtons; divide by 1000.")
    for name in (name for name in presses.columns if (joint := JOINT.fullmatch(name)) and joint[1] == "q"):
        angle = _median(np.abs(presses.columns[name]))
        if angle > LARGEST_ANGLE_RAD:
            factor = float(np.radians(1.0))
            fix = f"Degrees? Then {scaled_by(factor)}."
            findings.warn(
                place(name), "angles [rad]", f"a median of {angle:.3g}", fix, code=CODE, factor=factor
            )
    temperature = _median(presses.column("temperature_c"))
    if temperature > 150:
        findings.warn(place("temperature_c"), "degrees Celsius", f"a median of {temperature:.4g}", "Kelvin?")


def _median(column: FloatArray | None) -> float:
    """Return the median of the measured values; NaN, which compares as false, if there are none."""
    if column is None or not np.isfinite(column).any():
        return float("nan")
    return float(np.nanmedian(column))


def _check_frames(dataset: Dataset, frames: Frames, sheet: Sheet) -> None:
    presses, findings, place = dataset.presses, sheet.findings, sheet.column("force_n")
    step = _median(np.diff(frames.time_s))
    if step > 5:
        fix = "It looks like milliseconds; divide by 1000."
        findings.error(sheet.column("time_s"), "times [s]", f"a median step of {step:.3g} s", fix)
    force, middle = hold_means(dataset, frames.force_n), hold_means(dataset, frames.time_s)
    held = np.isfinite(middle)
    if not held.any():
        findings.warn(sheet.column("phase"), "frames of the hold of each press", "none")
        return
    ratio = _median(force[held]) / (_median(presses.force_n[held]) or np.nan)
    unit, got = unit_of_ratio(ratio), f"{ratio:.3g} times those of the presses in the hold"
    if ratio <= 0:
        fix = "Was the force recorded? Leave the frames out if it was not."
        findings.error(place, "the forces of the presses", got, fix)
    elif ratio > 30 or ratio < 1 / 30 or unit is not None:
        name, factor = unit or (("millinewtons", 1e-3) if ratio > 30 else ("kilonewtons", 1e3))
        fix = f"It looks like {name}; {scaled_by(factor)}."
        findings.error(place, "forces [N]", got, fix, code=CODE, factor=factor)
    elif abs(ratio - 1) > 0.2:
        findings.warn(place, "the same forces as in the table of presses", got)
    if not held.all():
        got = f"none for {int(np.sum(~held))} of {len(presses)}"
        findings.warn(sheet.column("phase"), "frames of the hold of each press", got)
    _check_dropouts(dataset, frames, force, sheet)
    _check_slides(dataset, frames, sheet)
    _check_same_presses(dataset, frames, force, sheet)
    _check_session_clock(dataset, middle, held, sheet)


def _check_dropouts(dataset: Dataset, frames: Frames, force: FloatArray, sheet: Sheet) -> None:
    """Check that frames of a hold have about the mean force (K,) of their press's hold, apart from a few."""
    row = dataset.frame_presses()
    held = np.flatnonzero((frames.phase == HOLD) & (row >= 0) & np.isfinite(frames.force_n))
    own = force[row[held]]
    lost = held[frames.force_n[held] < own * DROPPED]
    if len(lost) > MOST_DROPPED * max(len(held), 1):
        rows = listed(lost[:3] + 1, len(lost))
        sheet.findings.warn(
            sheet.column("force_n"), "about the force of the press in frames of its hold",
            f"less than a third of it in {len(lost)} of {len(held)} (rows {rows})",
            "Did the force sensor drop out? Leave these rows out.",
        )  # fmt: skip


def _check_same_presses(dataset: Dataset, frames: Frames, force: FloatArray, sheet: Sheet) -> None:
    """Check that the frames of a press belong to the press of that number: similar in image, and in place or force."""
    presses = dataset.presses
    image, place = hold_means(dataset, frames.taxel_columns()), hold_means(dataset, frames.position_m)
    both = np.isfinite(image) & np.isfinite(presses.counts)
    usual = column_medians(np.where(both, presses.counts, np.nan))
    size = np.where(both, presses.counts - usual, 0.0)
    apart = np.where(both, image - presses.counts, 0.0)
    away = np.linalg.norm(place - presses.position_m, axis=1) > max(APART_M, dataset.meta.position.sigma_m)
    with np.errstate(invalid="ignore", divide="ignore"):
        away |= np.abs(force / presses.force_n - 1) > APART_SHARE
    other = away & (np.linalg.norm(apart, axis=1) > APART_IMAGE * np.linalg.norm(size, axis=1))
    looked = int(both.any(axis=1).sum())
    if not other.any() or looked < FEWEST_COMPARED:
        return
    numbers = ", ".join(map(str, presses.press[other][:6]))
    got = f"another image at another place or force for {int(other.sum())} of {looked} (press {numbers})"
    say = sheet.findings.error if other.sum() > looked / 2 else sheet.findings.warn
    fix = "Are the presses numbered equally in both files?"
    say(sheet.column("press"), "frames of the presses of the table", got, fix)


def _check_slides(dataset: Dataset, frames: Frames, sheet: Sheet) -> None:
    """Check that contacts rest while they are held: the mean image over a slide belongs to no place."""
    presses, sigma = dataset.presses, dataset.meta.position.sigma_m
    if not np.isfinite(sigma):
        return
    hold = np.flatnonzero(frames.phase == HOLD)
    order = hold[np.argsort(frames.press[hold], kind="stable")]
    numbers, starts = np.unique(frames.press[order], return_index=True)
    holds = np.split(frames.position_m[order], starts[1:])
    noise = sample_noise_m(holds)
    slides = {int(number): slide_m(held, noise) for number, held in zip(numbers, holds, strict=True)}
    slides = {number: slid for number, slid in slides.items() if number in presses.press}
    sliding = [number for number, slid in slides.items() if slid > max(sigma, SMALLEST_M)]
    if sliding:
        shown = first_of((f"{number} ({1e3 * slides[number]:.2g} mm)" for number in sliding), 6)
        expected = f"contacts that stay in place in their hold, within sigma_m = {sigma:.2g} m"
        got = f"{len(sliding)} of {len(slides)} that slide: press {shown}"
        fix = "Shorten their holds to where the contact rests; `skincal import` does so."
        place = sheet.column(*POSITION)
        sheet.findings.warn(place, expected, got, fix, code="slides_in_hold", presses=sliding)


def _check_session_clock(dataset: Dataset, middle: FloatArray, held: BoolArray, sheet: Sheet) -> None:
    """Check that the hold of a press lies in its frames where ``t_hold_s`` to ``t_release_s`` says."""
    start, end = dataset.presses.column("t_hold_s"), dataset.presses.column("t_release_s")
    if start is None or end is None:
        return
    outside = held & ((middle < start - 1) | (middle > end + 1))
    if np.mean(outside[held]) > 0.5:
        first = int(np.flatnonzero(outside)[0])
        sheet.findings.error(
            sheet.column("time_s"),
            "one session clock: hold frames between t_hold_s and t_release_s of their press",
            f"press {dataset.presses.press[first]} held at {middle[first]:.4g} s in the frames, "
            f"from {start[first]:.4g} s to {end[first]:.4g} s in the presses",
            "Is one of them in milliseconds, or counted from another start?",
        )


def hold_means(dataset: Dataset, values: FloatArray | Iterable[FloatArray]) -> FloatArray:
    """Return the means of columns of the frames over the hold of each press, (K,) or (K, m); NaN without a hold.

    ``values`` are (n,) or (n, m), frame by frame, or an iterable of m columns (n,).
    """
    frames, presses = dataset.frames, dataset.presses
    assert frames is not None
    row = dataset.frame_presses()
    hold = (frames.phase == HOLD) & (row >= 0)
    row = row[hold]
    count = np.bincount(row, minlength=len(presses))[:, None]
    single = isinstance(values, np.ndarray) and values.ndim == 1
    columns = np.atleast_2d(values.T) if isinstance(values, np.ndarray) else values
    total = np.stack([np.bincount(row, c[hold], minlength=len(presses)) for c in columns], axis=1)
    mean = np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0)
    return mean[:, 0] if single else mean
