"""The zero of a measured force: what a force sensor reads between contacts, where nothing touches."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from skincal.dataset import IDLE, PHASES
from skincal.dataset.findings import Findings
from skincal.imports.cutting import cut_by_taxels
from skincal.imports.mapping import Mapping
from skincal.imports.recording import Cut, FloatArray, Series, runs
from skincal.statistics import robust_sigma

TOLERANCE: Final = 0.01
"""Force at rest that matters, as a part of the median force of presses (set by eye)."""

SIGMAS: Final = 3.0
"""And in standard deviations of its noise."""

FEWEST: Final = 4
"""Smallest number of samples from which the level of a gap between contacts is taken."""

FORCE_SPIKES: Final = 0.001
"""Part of the samples that may be spikes of the force sensor."""

WEAK: Final = 0.5
"""A force at which the taxels are at rest is no press if it is below this part of the presses that they see."""

ENDS: Final = 4
"""The first and the last of so many parts of the gaps tell whether the zero drifts."""


LENGTH: Final = (
    "The length of a vector has no zero that can be taken off: map the axis along the normal alone, column in place of "
    "columns in [columns.force_n]."
)
"""Advice for a force that is the length of a vector."""


@dataclass(frozen=True, eq=False)
class Rest:
    """Force in the gaps between contacts, in order: time [s] and level [N] of each gap, and its scatter [N].

    ``samples`` is the usual number in a gap, ``least_n`` the lowest tenth of all of them.
    """

    time_s: FloatArray
    level_n: FloatArray
    sigma_n: FloatArray
    samples: int
    least_n: float


def force_at_rest(series: Series, found: Cut) -> Rest:
    """Return the force between contacts, by the middle half of each gap: at its ends the force still rises or falls."""
    idle = np.ones(len(series), dtype=bool) if series.phase is None else series.phase == PHASES[IDLE]
    for one in (*found.spans, *found.rejected):
        idle[one.start : one.stop] = False
    middles = [
        (start + (stop - start) // 4, stop - (stop - start) // 4) for start, stop in runs(idle, series.part)
    ]
    middles = [(start, stop) for start, stop in middles if stop - start >= FEWEST]
    forces = [series.force_n[start:stop] for start, stop in middles]
    level = np.array([np.median(force) for force in forces])
    sigma = np.array([robust_sigma(force) for force in forces])
    time = np.array([series.time_s[start:stop].mean() for start, stop in middles])
    samples = int(np.median([len(force) for force in forces] or [0]))
    least = float(np.quantile(np.concatenate(forces), 0.1)) if forces else 0.0
    return Rest(time, level, sigma, samples, least)


def zeroed(series: Series, found: Cut) -> Series:
    """Return the series with the force at rest taken off, interpolated between the gaps before and after."""
    rest = force_at_rest(series, found)
    if not len(rest.level_n):
        return series
    return replace(series, force_n=series.force_n - np.interp(series.time_s, rest.time_s, rest.level_n))


def check_option(mapping: Mapping, findings: Findings) -> None:
    """Add an error for ``zero_force`` with a force that has no zero to be taken off."""
    quantity = mapping.quantity("force_n")
    if not mapping.cut.zero_force or quantity is None:
        return
    place, expected = f"{mapping.path.name}, [series], zero_force", "a measured force with a sign"
    if quantity.constant is not None:
        findings.error(place, expected, "a constant", "Remove zero_force.")
    elif len(quantity.sources) > 1:
        findings.error(place, expected, "the length of a vector", f"Remove zero_force. {LENGTH}")


def check_released(
    series: Series, images: FloatArray, mapping: Mapping, file: str, findings: Findings
) -> None:
    """Warn of a force that is not that of no contact where nothing touches: then rest counts as contact.

    Where it crosses ``off_n`` for moments only, between a rest and a press, the taxels (M, J) tell the rest.
    """
    rules, quantity = mapping.cut, mapping.quantity("force_n")
    level, got = float(np.quantile(series.force_n, FORCE_SPIKES)) if len(series) else 0.0, "at least"
    if len(series) and level <= rules.off_n:
        touched = cut_by_taxels(series, images, rules)
        rest, got = force_at_rest(series, touched), "where the taxels are at rest"
        level = float(np.median(rest.level_n)) if len(rest.level_n) else 0.0
        # Presses beside the sensor leave the taxels at rest, too, but they are released, and as strong as others.
        held = [series.force_n[span.hold : span.hold_stop] for span in touched.spans]
        strong = level > WEAK * float(np.median(np.concatenate(held or [[0.0]])))
        if strong or not len(rest.level_n) or rest.least_n <= rules.off_n:
            return
    length = quantity is not None and len(quantity.sources) > 1
    offset = "take it off: offset in [columns.force_n], in the unit of the column."
    fix = LENGTH if length else f"If the zero of the force sensor is off, or a preload was on it, {offset}"
    findings.warn(
        f"{file}, force_n", f"forces below off_n = {rules.off_n:g} N where nothing touches",
        f"{level:.3g} N {got}, so that rest counts as contact", f"{fix} Or raise on_n and off_n in [series].",
        code="zero_of_force",
    )  # fmt: skip


def check_zero(series: Series, found: Cut, mapping: Mapping, file: str, findings: Findings) -> None:
    """Warn of a force that differs from 0 where nothing touches: as much is wrong with that of every press."""
    rest, quantity = force_at_rest(series, found), mapping.quantity("force_n")
    if quantity is None or not found.spans or not len(rest.level_n):
        return
    usual = float(np.median([np.median(series.force_n[span.hold : span.hold_stop]) for span in found.spans]))
    few = max(len(rest.level_n) // ENDS, 1)
    whole, first, last = (
        float(np.median(part)) for part in (rest.level_n, rest.level_n[:few], rest.level_n[-few:])
    )
    # The length of a vector is that of its noise where nothing touches, however many samples there are.
    length = len(quantity.sources) > 1
    noise = SIGMAS * float(np.median(rest.sigma_n)) * (1.0 if length else 1.25 / np.sqrt(few * rest.samples))
    limit = max(TOLERANCE * usual, noise)
    drifts = abs(last - first) > limit
    if max(abs(whole), drifts * abs(first), drifts * abs(last)) <= limit:
        return
    got = f"{whole:.3g} N" + (f": it drifts from {first:.3g} N to {last:.3g} N" if drifts else "")
    entry = mapping.file.columns["force_n"]
    offset = entry.offset - entry.sign * whole / quantity.unit.factor
    if length:
        fix = LENGTH
    elif drifts:
        fix = "If nothing touched there, take it off: zero_force = true in [series]."
    else:
        fix = f"If nothing touched there, take it off: offset = {offset:.4g} in [columns.force_n]."
    findings.warn(
        f"{file}, force_n", f"0 N between contacts, within {limit:.2g} N", f"{got}, beside presses of {usual:.3g} N",
        fix, code="zero_of_force", level_n=whole, first_n=first, last_n=last,
    )  # fmt: skip
