"""Checks of units against what is physically plausible, each with the factor that corrects the values."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final

import numpy as np

from skincal.dataset import word_checks
from skincal.dataset.dataset import Dataset
from skincal.dataset.findings import Sheet
from skincal.dataset.rest import noise_at_rest, rest_levels
from skincal.dataset.tables import HOLD, IDLE, Frames
from skincal.dataset.uniform_pressure import uniform_pressure
from skincal.errors import first_of
from skincal.model.arrays import FloatArray, IntArray
from skincal.units import FORCES_N, LENGTHS_M

MOST_FRAMES: Final = 200_000
"""Number of frames that are checked."""

CODE: Final = "unit_suspect"

FORCE_UNITS: Final = {
    "grams-force": FORCES_N["gf"], "kilograms-force": FORCES_N["kgf"], "millinewtons": FORCES_N["mN"],
    "kilonewtons": FORCES_N["kN"], "centinewtons": FORCES_N["cN"], "pounds-force": FORCES_N["lbf"],
    "ounces-force": FORCES_N["ozf"], "dynes": FORCES_N["dyn"], "micronewtons": FORCES_N["uN"],
}  # fmt: skip

AS_LIKELY: Final = 3.0
"""Units that come as near to the usual pressure as the best one, within this factor, are named beside it."""

LENGTH_UNITS: Final = {
    "millimetres": LENGTHS_M["mm"], "centimetres": LENGTHS_M["cm"], "inches": LENGTHS_M["inch"],
    "micrometres": LENGTHS_M["um"],
}  # fmt: skip
"""Units of length in metres, the likeliest first."""

LENGTH_FACTORS: Final = (*LENGTH_UNITS.values(), 0.1, 10.0, 100.0, 1000.0)
"""Factors between positions and metres, if one of these units was written for another."""

FITS_BETTER: Final = 0.2
"""Gain in correlation with the images from which another unit of positions is meant (set by eye: on planes of 4 x 4 and
8 x 8 taxels right positions lose 0.29 or more by any factor, and those of permuted taxels gain 0.16 at most)."""

USUAL_PRESSURE_PA: Final = 3e4
"""Typical mean pressure under an indenter: 1 N on 0.3 cm². The unit that comes nearest to it is chosen."""

HIGH_PRESSURE_PA, LOW_PRESSURE_PA = 6e5, 4e3
"""Pressures outside which to ask for the unit: a skin is seldom pressed with 6 bar, or with 4 kPa."""

FORCE_BEYOND_DOUBT_N: Final = 50.0
"""A median force below this is never too high: a needle reaches any pressure."""

CONTACT_M2: Final = 1e-4
"""Largest plausible area of a contact, however large the indenter."""

RATIO_TOLERANCE: Final = 0.06
"""Tolerance of the ratio of two columns of force that differ by a unit."""

LEAST_COUNT: Final = 5.0
"""Values that all lie below this are not counts of a converter."""

FALLING_SIGMAS, FALLING_PART, FALLING_CELLS = 6.0, 4.0, 6
"""A sensor falls if readings this many sigmas below rest outweigh those above by this factor, in this many cells."""


FALLING_CORRELATION: Final = -0.35
"""Or if their correlation with the load is below this (images with permuted taxels have at least -0.15)."""

REACH_PITCHES: Final = 1.5
"""Reach of a press in pitches, with a tolerance for the nominal pose."""


def force_units(median_n: float, area_m2: float) -> dict[str, float]:
    """Return the units, with their factors, that would make a median force plausible; the most usual first.

    Magnitude alone does not tell units apart whose factors are near each other. None if the force, read as newtons, is
    plausible on the largest area that the indenter presses on [m²].
    """
    least_area = min(area_m2, CONTACT_M2)
    low = median_n / least_area < LOW_PRESSURE_PA
    high = median_n / area_m2 > HIGH_PRESSURE_PA and median_n > FORCE_BEYOND_DOUBT_N
    if not (low or high) or median_n <= 0:
        return {}
    area = least_area if low else area_m2

    def unlikely(name: str) -> float:
        return abs(float(np.log(median_n * FORCE_UNITS[name] / area / USUAL_PRESSURE_PA)))

    fitting = [name for name in FORCE_UNITS if (FORCE_UNITS[name] > 1) == low]
    least = min(map(unlikely, fitting)) + np.log(AS_LIKELY)
    return {name: FORCE_UNITS[name] for name in fitting if unlikely(name) <= least}


def any_of(units: dict[str, float]) -> str:
    """Return names of units, each with what corrects its values."""
    return ", or ".join(f"{name} ({scaled_by(factor)})" for name, factor in units.items())


def length_unit(
    dataset: Dataset, points: FloatArray, centre: FloatArray, reach_m: float
) -> tuple[str, float] | None:
    """Return the unit of positions (n, 3) that are no metres, with its factor; None if there is none.

    Of the units that bring most presses within ``reach_m`` of the nominal centre (3,) of the patch [m], it is the one
    whose places go best with the images. Places that only lie elsewhere, no farther apart than presses are, belong to
    another frame, not to another unit: any unit that is small enough would bring them near.
    """
    wrong = np.median(np.abs(points - centre), axis=0) > reach_m
    apart = np.median(np.abs(points - np.median(points, axis=0)), axis=0)
    if (apart[wrong] <= reach_m).all():
        return None

    def away(factor: float) -> float:
        return float(np.median(np.linalg.norm(np.where(wrong, points * factor, points) - centre, axis=1)))

    near = {name: factor for name, factor in LENGTH_UNITS.items() if away(factor) <= reach_m}
    if len(points) != len(dataset.presses):
        return next(iter(near.items()), None)
    return max(
        near.items(),
        key=lambda item: _fits_images(dataset, np.where(wrong, points * item[1], points)),
        default=None,
    )


def length_factor(dataset: Dataset, points: FloatArray, centre: FloatArray, reach_m: float) -> float | None:
    """Return the factor of positions (K, 3), near the patch or not, that fits them to the images; None if 1 fits.

    On surfaces other than a plane, positions of another unit are off the surface.
    """
    if len(points) != len(dataset.presses) or not dataset.meta.surface.is_plane:
        return None
    fits = {
        factor: _fits_images(dataset, points * factor)
        for factor in LENGTH_FACTORS
        if float(np.median(np.linalg.norm(points * factor - centre, axis=1))) <= reach_m
    }
    best = max(fits, key=fits.__getitem__, default=1.0)
    # Overflown words fall with load.
    return best if fits and fits[best] > max(_fits_images(dataset, points), 0.0) + FITS_BETTER else None


def _fits_images(dataset: Dataset, points: FloatArray) -> float:
    """Return the correlation of the images with the loads that presses at some points (K, 3) would give."""
    there = replace(dataset, presses=replace(dataset.presses, position_m=points))
    return word_checks.correlation(dataset.presses.counts, expected_load(there))


def unit_of_ratio(ratio: float) -> tuple[str, float] | None:
    """Return the unit of a force that is ``ratio`` times the same force in newtons; None if there is none."""
    name = min(FORCE_UNITS, key=lambda unit: abs(ratio * FORCE_UNITS[unit] - 1))
    return (name, FORCE_UNITS[name]) if abs(ratio * FORCE_UNITS[name] - 1) < RATIO_TOLERANCE else None


def scaled_by(factor: float) -> str:
    """Return the advice for values that a factor corrects."""
    if factor >= 1:
        return f"multiply by {factor:.6g}"
    whole = np.isclose(1 / factor, round(1 / factor))
    return f"divide by {1 / factor:.6g}" if whole else f"multiply by {factor:.6g}"


def check_values(dataset: Dataset, sheet: Sheet, frame_sheet: Sheet | None) -> None:
    """Report problems of the taxel values themselves in the findings of the sheets of presses and frames."""
    tables = [(sheet, dataset.presses.counts)]
    if dataset.frames is not None and frame_sheet is not None:
        tables.insert(0, (frame_sheet, dataset.frames.counts_of(_some(dataset.frames))))
    if not any(_check_words(dataset, own, counts) for own, counts in tables):
        _check_whole(dataset, sheet)
        _check_direction(dataset, sheet)


def expected_load(dataset: Dataset) -> FloatArray:
    """Return an estimate of each taxel's load per press (K, J): the force, less with distance, at the nominal pose."""
    presses, layout = dataset.presses, dataset.layout()
    force = np.repeat(np.abs(presses.force_n)[:, None], dataset.meta.sensor.taxels, axis=1)
    if not np.isfinite(dataset.meta.position.sigma_m) or not np.isfinite(presses.position_m).all():
        return force
    centres = dataset.surface().wrap(dataset.nominal_pose(), layout.centres_m)[0]
    away = np.linalg.norm(presses.position_m[:, None] - centres, axis=2)
    low, high = layout.bounds_m
    pitch = float(np.sqrt(np.prod(high - low) / max(dataset.meta.sensor.taxels, 1)))
    return force * np.exp(-0.5 * (away / (REACH_PITCHES * pitch)) ** 2)


def _some(frames: Frames, phase: int | None = None) -> IntArray:
    """Return the rows of frames to check, evenly spread: a part of a long session says as much as all of it."""
    rows = np.arange(len(frames)) if phase is None else np.flatnonzero(frames.phase == phase)
    return rows[:: max(1, len(rows) // MOST_FRAMES)]


def _check_words(dataset: Dataset, sheet: Sheet, counts: FloatArray) -> bool:
    names = list(dataset.meta.sensor.taxel_columns())
    order = word_checks.find_byte_order(counts)
    if order:
        mapping = f"[taxels] {order}"
        part, parts = ("half", "halves") if "swap_words" in order else ("byte", "bytes")
        sheet.findings.warn(
            sheet.file, f"readings whose high {part} changes with load, and whose low {part} is the fine part",
            f"readings that scatter far less with their two {parts} exchanged",
            f"The two {parts} of each reading are exchanged: import again with {mapping}.",
            code="bytes_swapped", mapping=mapping,
        )  # fmt: skip
        return True
    of_presses = counts is dataset.presses.counts
    rests = not uniform_pressure(dataset)
    load = image_load = None
    if of_presses:
        presses, load = dataset.presses, expected_load(dataset)
        image_load = word_checks.load_from_images(presses.position_m, presses.force_n, counts)
    wrapped = word_checks.find_wrapped(counts, load, rests=rests, image_load=image_load)
    if wrapped is None and not of_presses and dataset.frames is not None:
        # The first ones, none left out: a fall is one from one frame to the next.
        rows = np.arange(min(len(dataset.frames), MOST_FRAMES))
        frames = dataset.frames
        wrapped = word_checks.find_falls(frames.counts_of(rows), frames.press[rows], frames.force_n[rows])
        if wrapped is None and rests:
            rows = _some(frames)
            force = np.where(frames.press[rows] < 0, 0.0, frames.force_n[rows])
            wrapped = word_checks.find_below_zero(counts, np.broadcast_to(force[:, None], counts.shape))
    if wrapped is None:
        return False
    mapping = f'[taxels] word = "{wrapped.word}"' if wrapped.word else ""
    mend = f", or import again with {mapping}" if mapping else ""
    taxels = [names[j] for j in wrapped.taxels]
    sheet.findings.warn(
        sheet.file, "readings within the range of their words",
        f"{wrapped.readings} readings at the other end of {wrapped.bits} bits, {wrapped.evidence}, "
        f"from {first_of(taxels, 6)}",
        f"The words have overflowed: {wrapped.mend}{mend}.",
        code="counter_wrapped", modulus=2**wrapped.bits, mapping=mapping, taxels=taxels,
    )  # fmt: skip
    return True


def _check_whole(dataset: Dataset, sheet: Sheet) -> None:
    sensor = dataset.meta.sensor
    values = np.abs(dataset.presses.counts[np.isfinite(dataset.presses.counts)])
    top = float(values.max(initial=0.0))
    broken = (values != np.rint(values)).any()
    if sensor.unit not in (None, "counts") or top >= LEAST_COUNT or not broken:
        return
    frames = dataset.frames
    step = value_step(dataset.presses.counts if frames is None else frames.counts_of(_some(frames)))
    details: dict[str, Any] = {} if step is None else {"factor": 1 / step}
    likely = "shares of full scale" if top <= 1.0 else "volts"
    mapping = '[sensor] unit = "V"' + (", integer = false" if sensor.integer else "")
    scale = f", or import with [taxels] scale = {1 / step:.6g}, which makes them whole" if step else ""
    got = f"{top:.3g} at most: volts, or {likely}?" if likely != "volts" else f"{top:.3g} at most: volts?"
    (sheet.findings.warn if sensor.integer else sheet.findings.note)(
        sheet.file, "counts of a converter (no other [sensor] unit is given)", got,
        f"Values of any unit can be fitted: write {mapping}, or the actual unit{scale}.",
        code=CODE, mapping=mapping, **details,
    )  # fmt: skip


def value_step(counts: FloatArray) -> float | None:
    """Return the step of a converter behind scaled readings (n, J); None if they are not multiples of a step."""
    values = np.unique(counts[np.isfinite(counts)])
    steps, size = np.diff(values), float(np.abs(values).max(initial=0.0))
    steps = steps[steps > 1e-6 * size]
    if len(values) < 3 or not steps.size:
        return None
    step = float(steps.min())
    part = values / step
    # Values written with few digits are multiples of a power of ten for that reason alone.
    return step if np.abs(part - np.rint(part)).max() < 0.02 and size / step < 2**20 else None


def _check_direction(dataset: Dataset, sheet: Sheet) -> None:
    frames, subtracted = dataset.frames, dataset.meta.sensor.baseline == "subtracted"
    counts = dataset.presses.counts
    # Of a falling sensor, the readings at rest are the high ones.
    turned = replace(dataset, presses=replace(dataset.presses, counts=-counts))
    noise = min(noise_at_rest(dataset), noise_at_rest(turned))
    rest = rest_levels(dataset)
    if frames is not None and np.bincount(frames.phase, minlength=4)[[IDLE, HOLD]].all():
        counts = frames.counts_of(_some(frames, HOLD))
        idle = frames.counts_of(_some(frames, IDLE))
        rest = np.where(np.isfinite(idle).any(axis=0), column_medians(idle), rest)
    elif not subtracted:
        # The level at rest of a falling sensor is not below its readings.
        rest = column_medians(counts)
    apart = counts - rest
    clear = np.abs(apart) > FALLING_SIGMAS * np.maximum(noise, 1e-12)
    clear &= np.isfinite(apart)
    below, above = -apart[clear & (apart < 0)].sum(), apart[clear & (apart > 0)].sum()
    cells = int((clear & (apart < 0)).sum())
    against = word_checks.correlation(dataset.presses.counts, expected_load(dataset)) < FALLING_CORRELATION
    falls = cells >= FALLING_CELLS and below > FALLING_PART * above
    # Taxels that are pressed elsewhere than at the nominal pose also fall with their load, but stay above rest.
    at_rest = subtracted or counts is not dataset.presses.counts
    if not (falls or (against and (not at_rest or below > above))):
        return
    mapping = f"[taxels] falling_from = {0 if subtracted else float(np.nanmax(counts)):.6g}"
    got = f"values that fall by up to {float(-np.nanmin(apart)):.3g} below rest"
    sheet.findings.warn(
        sheet.file, "values that grow with load", got, f"Convert them: import with {mapping}.", CODE,
        factor=-1.0, mapping=mapping,
    )  # fmt: skip


def column_medians(values: FloatArray) -> FloatArray:
    """Return the median of each column (J,); NaN for one that is NaN throughout."""
    result = np.full(values.shape[1], np.nan)
    alive = np.isfinite(values).any(axis=0)
    result[alive] = np.nanmedian(values[:, alive], axis=0)
    return result
