"""Cutting of a time series into presses: contacts by a force threshold, and the hold of each contact.

The rule: a contact is a stretch with a force above ``off_n`` that rises above ``on_n`` somewhere. Its level is the
force that it keeps longest: the middle of the band of width ``2 * band * level`` that holds most of the time, among
forces above half of the largest (so that a single spike decides nothing). The hold is the longest stretch inside that
band; one or two samples outside do not end it. Each end is trimmed to where the force is no lower than a quarter of
the band below the median of its half, so that it contains little of the ramps. The part before the hold is loading, the
part after it unloading.
"""

from __future__ import annotations

import numpy as np

from skincal.imports.mapping_file import CutRules
from skincal.imports.plateaus import cut_plateaus
from skincal.imports.recording import FloatArray
from skincal.imports.series import BoolArray, Cut, Rejected, Series, Span, longest, runs

BRIDGED = 2
"""Samples in succession outside the band that do not end a hold: a spike of the force sensor is not a release."""

TRIM = 0.25
"""A hold starts and ends no lower below its level than this part of the band."""

HIGH_SHARE = 0.9
"""Quantile of a contact's forces that counts as the largest: spikes lie above it."""


def cut(series: Series, rules: CutRules) -> Cut:
    """Return the presses of a series, by force or by plateaus; for numbered presses see ``cut_numbered``."""
    found = contacts(series, rules)
    if rules.by == "plateaus":
        return cut_plateaus(series, rules, found)
    spans: list[Span] = []
    rejected: list[Rejected] = []
    for start, stop in found:
        hold = hold_of(series.time_s[start:stop], series.force_n[start:stop], rules)
        if isinstance(hold, str):
            rejected.append(Rejected(start, stop, hold))
        else:
            spans.append(Span(len(spans), start, start + hold[0], start + hold[1], stop))
    return Cut(tuple(spans), tuple(rejected))


def contacts(series: Series, rules: CutRules) -> list[tuple[int, int]]:
    """Return the stretches of contact ``[start, stop)`` in order."""
    touching = runs(series.force_n > rules.off_n, series.part)
    return [(start, stop) for start, stop in touching if series.force_n[start:stop].max() > rules.on_n]


def hold_of(time_s: FloatArray, force_n: FloatArray, rules: CutRules) -> tuple[int, int] | str:
    """Return the hold of one contact ``[start, stop)``, or the reason why there is none.

    Args:
        time_s: times of the contact [s], shape (n,).
        force_n: forces of the contact [N], shape (n,).
        rules: band, settling time and shortest length.
    """
    level = kept_level(time_s, force_n, rules.band)
    inside = np.abs(force_n - level) <= rules.band * abs(level)
    stretch = longest(runs(_bridged(inside)), time_s)
    assert stretch is not None
    start, stop = stretch
    start, stop = _trimmed(np.where(inside, force_n, 0.0), start, stop, rules.band)
    start = int(np.count_nonzero(time_s[:stop] < time_s[start] + rules.settle_s))
    lasts = float(time_s[stop - 1] - time_s[start]) if start < stop else 0.0
    if start >= stop or lasts < rules.min_hold_s:
        return f"no hold of {rules.min_hold_s:g} s (min_hold_s)"
    return start, stop


def _trimmed(force_n: FloatArray, start: int, stop: int, band: float) -> tuple[int, int]:
    """Return a stretch without the ramps at its ends; each end is compared with its own half, as a force may relax.

    Bridged samples outside the band are 0: a spike on a ramp does not make it part of the hold.
    """
    middle, share = (start + stop + 1) // 2, 1 - TRIM * band
    early, late = force_n[start:middle], force_n[middle - 1 : stop]
    first = np.flatnonzero(early >= share * float(np.median(early)))
    last = np.flatnonzero(late >= share * float(np.median(late)))
    return start + int(first[0]), middle + int(last[-1])


def kept_level(time_s: FloatArray, force_n: FloatArray, band: float) -> float:
    """Return the force that a contact keeps longest [N].

    Args:
        time_s: times [s], shape (n,).
        force_n: forces [N], shape (n,).
        band: relative half width of the band of equal forces.
    """
    high = float(np.quantile(force_n, HIGH_SHARE, method="lower"))
    weight = np.gradient(time_s) if len(time_s) > 1 else np.ones(1)
    chosen = force_n >= high / 2
    order = np.argsort(force_n[chosen], kind="stable")
    force, mass = force_n[chosen][order], weight[chosen][order]
    # The second, narrower search keeps slow ramps that end in the band from lowering the level.
    for width in (band, TRIM * band):
        kept = _densest(force, mass, width)
        force, mass = force[kept], mass[kept]
    return float(np.median(force))


def _densest(force_n: FloatArray, mass: FloatArray, band: float) -> slice:
    """Return the slice of ascending forces in the band of relative half width ``band`` with the greatest mass."""
    upper = np.searchsorted(force_n, force_n * (1 + band) / (1 - band), side="right")
    total = np.concatenate([[0.0], np.cumsum(mass)])
    best = int(np.argmax(total[upper] - total[: len(force_n)]))
    return slice(best, int(upper[best]))


def _bridged(mask: BoolArray) -> BoolArray:
    """Return the mask with short gaps between stretches filled."""
    filled = mask.copy()
    for start, stop in runs(~mask):
        if start > 0 and stop < len(mask) and stop - start <= BRIDGED:
            filled[start:stop] = True
    return filled
