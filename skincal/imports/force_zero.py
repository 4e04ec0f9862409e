"""The zero of a measured force: what a force sensor reads between contacts, where nothing touches."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from skincal.dataset import IDLE, PHASES
from skincal.dataset.findings import Findings
from skincal.imports.mapping import Mapping
from skincal.imports.recording import Cut, FloatArray, Series, runs

TOLERANCE: Final = 0.01
"""Force at rest that matters, as a part of the median force of presses (set by eye)."""

SIGMAS: Final = 3.0
"""And in standard deviations of its noise."""

FEWEST: Final = 4
"""Smallest number of samples from which the level of a gap between contacts is taken."""

ENDS: Final = 4
"""The first and the last of so many parts of the gaps tell whether the zero drifts."""


LENGTH: Final = (
    "The length of a vector has no zero that can be taken off: map the axis along the normal alone, column in place of "
    "columns in [columns.force_n]."
)
"""Advice for a force that is the length of a vector."""


@dataclass(frozen=True, eq=False)
class Rest:
    """Force in the gaps between contacts, in order: time [s] and level [N] of each gap, and its scatter [N]."""

    time_s: FloatArray
    level_n: FloatArray
    sigma_n: FloatArray
    samples: int


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
    away = [np.median(np.abs(force - one)) for force, one in zip(forces, level, strict=True)]
    time = np.array([series.time_s[start:stop].mean() for start, stop in middles])
    return Rest(time, level, 1.4826 * np.array(away), int(np.median([len(force) for force in forces] or [0])))


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
    got = (
        "a constant"
        if quantity.constant is not None
        else "the length of a vector"
        if len(quantity.sources) > 1
        else ""
    )
    if got:
        place, fix = (
            f"{mapping.path.name}, [series], zero_force",
            f"Remove zero_force. {LENGTH}" * (got != "a constant"),
        )
        findings.error(place, "a measured force with a sign", got, fix or "Remove zero_force.")


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
