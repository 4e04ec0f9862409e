"""Cutting of a time series into presses: by force, by the taxels alone, or by press numbers; holds and plateaus.

The rule: a contact is a stretch with a force above ``off_n`` that rises above ``on_n`` somewhere. Its level is the
force that it keeps longest: the middle of the band of width ``2 * band * level`` that holds most of the time, among
forces above half of the largest (so that a single spike decides nothing). The hold is the longest stretch inside that
band; one or two samples outside do not end it. Each end is trimmed to where the force is no lower than a quarter of
the band below the median of its half, so that it contains little of the ramps. The part before the hold is loading, the
part after it unloading.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from skincal.dataset import HOLD, IDLE, LOAD, PHASES, UNLOAD
from skincal.dataset.findings import Findings, listed
from skincal.imports.clock import LARGEST_STEP
from skincal.imports.mapping_file import CutRules
from skincal.imports.recording import (
    BoolArray,
    Column,
    Cut,
    FloatArray,
    IntArray,
    Rejected,
    Series,
    Span,
    runs,
)
from skincal.statistics import robust_sigma

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
    every = _sorted(_press(series, rules, 0, start, stop) for start, stop in found)
    return replace(every, spans=tuple(replace(span, number=i) for i, span in enumerate(every.spans)))


def _sorted(found: Iterable[Span | Rejected]) -> Cut:
    every = list(found)
    spans = tuple(one for one in every if isinstance(one, Span))
    return Cut(spans, tuple(one for one in every if isinstance(one, Rejected)))


def _press(series: Series, rules: CutRules, number: int, start: int, stop: int) -> Span | Rejected:
    force = series.force_n[start:stop]
    if series.sigma_n:  # a weak image leaves a narrow band by its noise alone
        high = float(np.quantile(force, HIGH_SHARE))
        noise = BAND_SIGMAS * series.sigma_n / max(high, series.sigma_n)
        rules = replace(rules, band=max(rules.band, min(noise, WIDEST)))
    hold = hold_of(series.time_s[start:stop], force, rules)
    if isinstance(hold, str):
        return Rejected(start, stop, hold)
    return Span(number, start, start + hold[0], start + hold[1], stop)


def contacts(series: Series, rules: CutRules) -> list[tuple[int, int]]:
    """Return the stretches of contact ``[start, stop)`` in order."""
    touching = runs(series.force_n > rules.off_n, series.part)
    return [(start, stop) for start, stop in touching if series.force_n[start:stop].max() > rules.on_n]


def hold_of(time_s: FloatArray, force_n: FloatArray, rules: CutRules) -> tuple[int, int] | str:
    """Return the hold of one contact ``[start, stop)``, or the reason why there is none.

    Nobody knows what a contact does while nothing is recorded, or how long that is if the clock was set: a hold has no
    gap.
    """
    steps = np.diff(time_s, prepend=time_s[:1])
    usual = float(np.median(steps[1:])) if len(steps) > 1 else 0.0
    gaps = steps > max(rules.min_hold_s, LARGEST_STEP * usual)
    time_s = time_s - np.cumsum(np.where(gaps, steps - usual, 0.0))
    level = kept_level(time_s, force_n, rules.band)
    inside = np.abs(force_n - level) <= rules.band * abs(level)
    held = runs(_bridged(inside), np.cumsum(gaps, dtype=np.int64))
    start, stop = max(held, key=lambda run: float(time_s[run[1] - 1] - time_s[run[0]]))
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
    """Return the force that a contact keeps longest [N]."""
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
    filled = mask.copy()
    for start, stop in runs(~mask):
        filled[start:stop] |= start > 0 and stop < len(mask) and stop - start <= BRIDGED
    return filled


def cut_plateaus(series: Series, rules: CutRules, contacts: list[tuple[int, int]]) -> Cut:
    """Return the plateaus of every contact."""
    spans: list[Span] = []
    rejected: list[Rejected] = []
    for start, stop in contacts:
        time, force = series.time_s[start:stop], series.force_n[start:stop]
        still = np.abs(slopes(time, force, rules.window_s)) < rules.slope_n_per_s
        least = max(rules.min_hold_s + rules.settle_s, 1e-12)
        flat = runs(still & (force > rules.on_n))
        found = [(first, last) for first, last in flat if time[last - 1] - time[first] >= least]
        if not found:
            why = f"no plateau of {rules.min_hold_s:g} s below {rules.slope_n_per_s:g} N/s"
            rejected.append(Rejected(start, stop, why))
        begin, before = start, 0.0
        for i, (first, last) in enumerate(found):
            hold = int(np.count_nonzero(time[:last] < time[first] + rules.settle_s))
            level = float(np.median(force[hold:last]))
            end = stop if i == len(found) - 1 else start + last
            branch = "up" if level > before else "down"
            spans.append(Span(len(spans), begin, start + hold, start + last, end, branch == "up", branch))
            begin, before = end, level
    return Cut(tuple(spans), tuple(rejected))


def slopes(time_s: FloatArray, force_n: FloatArray, window_s: float) -> FloatArray:
    """Return the change of force over a window around each sample [N/s], shape (n,); a shorter one at the ends."""
    if len(time_s) < 2:
        return np.full(len(time_s), np.inf)
    early = np.maximum(time_s - window_s / 2, time_s[0])
    late = np.minimum(time_s + window_s / 2, time_s[-1])
    change = np.interp(late, time_s, force_n) - np.interp(early, time_s, force_n)
    return np.divide(change, late - early, out=np.full(len(time_s), np.inf), where=late > early)


ON_SIGMAS, OFF_SIGMAS = 8.0, 4.0
"""Thresholds of the sum of the taxels, in standard deviations of its noise at rest, for start and end of a contact."""

LEAST_PART: Final = 0.1
"""And as a part of the strongest contacts (a tolerance for creep and crosstalk of rests)."""

REST_QUANTILE, REST_SIGMAS, REST_PART = 0.05, 6.0, 0.05
"""The rest is the samples that exceed this quantile by so many standard deviations of noise, or this part of the
strongest contacts (a tolerance for drift), at most."""

BAND_SIGMAS, WIDEST = 3.0, 0.45
"""Least half width of the band of a hold by the taxels, in standard deviations of their sum, and its upper bound."""


@dataclass(frozen=True, eq=False)
class Activity:
    """Sum over the taxels of their distance above rest (M,), its level and noise at rest, and its range."""

    values: FloatArray
    rest: float
    sigma: float
    top: float


def activity_of(images: FloatArray) -> Activity:
    """Return the activity of images (M, J); weak contacts neither raise its level at rest nor its noise."""
    images = images[:, np.isfinite(images).any(axis=0)]  # without taxels that were never read
    # The rest of a taxel is the lowest tenth of its values.
    values = np.nansum(np.maximum(images - np.nanquantile(images, 0.1, axis=0), 0.0), axis=1)
    low = values <= np.quantile(values, 0.95) / 2
    steps = np.abs(np.diff(values))[low[1:] & low[:-1]]
    noise = robust_sigma(steps, 0.0) / np.sqrt(2) if len(steps) else 0.0
    least, top = np.quantile(values, [REST_QUANTILE, 0.99])
    # A converter that clips often repeats its value: the scatter of the rest shows the noise then, and drift.
    rest = values[values <= least + max(REST_SIGMAS * noise, REST_PART * (top - least))]
    level = float(np.median(rest))
    sigma = max(noise, robust_sigma(rest, level))
    return Activity(values, level, sigma, float(top) - level)


def cut_by_taxels(series: Series, images: FloatArray, rules: CutRules) -> Cut:
    """Return the contacts of a series, by the distance of its images (M, J) from their level at rest.

    Weaker changes of the image, alone and as long as a hold, are rejected: they may be contacts, and are no rest.
    """
    activity = activity_of(images)
    noise = ON_SIGMAS * activity.sigma
    on = max(noise, LEAST_PART * activity.top)
    series = replace(series, force_n=activity.values - activity.rest, sigma_n=activity.sigma)
    found = cut(series, _thresholds(rules, on, activity.sigma))
    if noise and noise < on:
        known = np.zeros(len(series), dtype=bool)
        for one in (*found.spans, *found.rejected):
            known[one.start : one.stop] = True
        weak = cut(series, _thresholds(rules, noise, activity.sigma)).spans
        why = f"its image is weaker than {100 * LEAST_PART:.0f} % of the strongest ones"
        left = [Rejected(one.start, one.stop, why) for one in weak if not known[one.start : one.stop].any()]
        found = replace(found, rejected=(*found.rejected, *left))
    return widened(found, activity.values, series.part)


def _thresholds(rules: CutRules, on: float, sigma: float) -> CutRules:
    return replace(rules, by="force", on_n=on, off_n=max(OFF_SIGMAS * sigma, on / 2))


def widened(found: Cut, activity: FloatArray, part: IntArray) -> Cut:
    """Return a cut whose contacts reach to where the activity (M,) is down to its level in the gap before or after.

    Below the thresholds a contact begins and ends, too: as rest, its weak images would raise the level of rest.
    """
    every = (*found.spans, *found.rejected)
    idle = np.ones(len(activity), dtype=bool)
    for one in every:
        idle[one.start : one.stop] = False
    starts, stops = {one.start: one.start for one in every}, {one.stop: one.stop for one in every}
    for start, stop in runs(idle, part):
        middle = activity[start + (stop - start) // 4 : stop - (stop - start) // 4]
        quiet = start + np.flatnonzero(activity[start:stop] <= np.median(middle))
        if start and part[start - 1] == part[start]:
            stops[start] = int(quiet[0])
        if stop < len(part) and part[stop] == part[stop - 1]:
            starts[stop] = int(quiet[-1]) + 1
    spans = (replace(span, start=starts[span.start], stop=stops[span.stop]) for span in found.spans)
    rejected = (replace(one, start=starts[one.start], stop=stops[one.stop]) for one in found.rejected)
    return Cut(tuple(spans), tuple(rejected))


def stretches(series: Series) -> list[tuple[int, int]]:
    """Return the stretch ``[start, stop)`` of each number of a press, in order."""
    assert series.press is not None
    changes = np.flatnonzero((np.diff(series.press) != 0) | (np.diff(series.part) != 0)) + 1
    edges = np.concatenate([[0], changes, [len(series)]]).astype(np.int64)
    return [(int(a), int(b)) for a, b in pairwise(edges) if series.press[a] >= 0]


def cut_numbered(series: Series, rules: CutRules, file: str, findings: Findings) -> Cut:
    """Return one press per number; a number that recurs later is an error."""
    assert series.press is not None
    found = stretches(series)
    numbers = [int(series.press[start]) for start, _ in found]
    if again := sorted(number for number, count in Counter(numbers).items() if count > 1):
        fix, got = "Renumber them, or remove [columns.press] and cut by force.", listed(again[:6], len(again))
        findings.error(f"{file}, press", "each press in one stretch of rows", f"{got} again later", fix)
    return _sorted(_span(series, rules, n, *ends) for n, ends in zip(numbers, found, strict=True))


def _span(series: Series, rules: CutRules, number: int, start: int, stop: int) -> Span | Rejected:
    if series.phase is not None:
        held = np.flatnonzero(series.phase[start:stop] == PHASES[HOLD])
        if not held.size:
            return Rejected(start, stop, f'no row with the phase "{PHASES[HOLD]}"')
        return Span(number, start, start + int(held[0]), start + int(held[-1]) + 1, stop)
    # The way to the skin and back, without force, does not belong to the press.
    touching = np.flatnonzero(series.force_n[start:stop] > rules.off_n)
    if not touching.size:
        return Rejected(start, stop, f"no force above {rules.off_n:g} N (off_n)")
    first, last = start + int(touching[0]), start + int(touching[-1]) + 1
    found = _press(series, rules, number, first, last)
    return replace(found, start=start, stop=stop) if isinstance(found, Rejected) else found


def check_phases(phase: Column, file: str, findings: Findings) -> None:
    """Add an error for words that are not phases."""
    if strange := sorted({str(word) for word in phase} - set(PHASES)):
        fix = f'Add words = {{ {strange[0] or chr(39) * 2} = "{PHASES[0]}", … }} to [columns.phase].'
        got = listed(strange[:6], len(strange))
        findings.error(f"{file}, phase", f"one of {', '.join(PHASES)}", got, fix)


def phases(series: Series, spans: tuple[Span, ...]) -> NDArray[np.int8]:
    """Return the phase of every sample, shape (M,)."""
    if series.phase is not None:
        return np.array([PHASES.index(word) for word in series.phase], dtype=np.int8)
    phase = np.full(len(series), IDLE, dtype=np.int8)
    for span in spans:
        phase[span.start : span.hold] = LOAD if span.rising else UNLOAD
        phase[span.hold : span.hold_stop] = HOLD
        phase[span.hold_stop : span.stop] = UNLOAD
    return phase
