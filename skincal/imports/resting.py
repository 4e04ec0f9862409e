"""Contacts that slide while they are held: their hold is cut to where the contact rests."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from skincal.covariates import POSITION
from skincal.dataset.findings import Findings
from skincal.dataset.placement import SMALLEST_M, rests, sample_noise_m, slide_m
from skincal.errors import first_of, input_error
from skincal.imports.mapping import Mapping
from skincal.imports.mapping_file import Slides
from skincal.imports.recording import Cut, FloatArray, Recording, Rejected, Series, Span

ADVICE: Final[dict[Slides, str]] = {
    "refuse": 'slides = "cut" takes the part of each hold in which the contact rests.',
    "keep": "Their image is the mean over the slide, at its mean position.",
    "cut": 'Their holds were cut to where the contact rests; slides = "refuse" in [series] refuses such recordings.',
}
"""Advice for contacts that slide, by ``slides`` of ``[series]``."""

SHOWN = 8
TRIES = 6
"""Largest number of cuts by the noise of what an earlier one left."""


def rested(
    found: Cut, series: Series, recording: Recording, mapping: Mapping, file: str, findings: Findings
) -> Cut:
    """Return the cut with every hold shortened to where the contact rests, if ``slides`` of ``[series]`` says so.

    Raises:
        InputError: contacts slide, and ``slides`` is ``refuse``.
    """
    sigma = mapping.meta.position.sigma_m
    still = mapping.cut.still_m if mapping.cut.still_m is not None else sigma
    if not np.isfinite(still):
        return found
    still = max(still, SMALLEST_M)
    position = recording.vector(POSITION)
    noise = sample_noise_m([position[span.hold : span.hold_stop] for span in found.spans])
    slides = {span.number: slide_m(position[span.hold : span.hold_stop], noise) for span in found.spans}
    sliding = [span for span in found.spans if slides[span.number] > still]
    if not sliding:
        return found
    rule = mapping.cut.slides if series.phase is None else "keep"
    shown = first_of((f"{s.number} ({1e3 * slides[s.number]:.2g} mm)" for s in sliding), SHOWN)
    expected = f"contacts that rest in their hold, within {1e3 * still:.2g} mm (still_m in [series])"
    got = f"{len(sliding)} of {len(found.spans)} that slide: press {shown}"
    if rule == "refuse":
        raise input_error(file, expected, got, ADVICE[rule])
    findings.warn(file, expected, got, ADVICE[rule], "slides_in_hold", presses=[s.number for s in sliding])
    if rule == "keep":
        return found
    spans: list[Span] = []
    rejected = list(found.rejected)
    parts = _rests(found, {span.number for span in sliding}, position, still, noise)
    why = f"the contact rests for less than {mapping.cut.min_hold_s:g} s of its hold (min_hold_s)"
    for span, (start, stop) in zip(found.spans, parts, strict=True):
        time = series.time_s[span.hold + start : span.hold + stop]
        short = len(time) < 2 or time[-1] - time[0] < mapping.cut.min_hold_s
        if span in sliding and short:
            rejected.append(Rejected(span.start, span.stop, why))
        else:
            spans.append(replace(span, hold=span.hold + start, hold_stop=span.hold + stop))
    return Cut(tuple(spans), tuple(rejected))


def _rests(
    found: Cut, sliding: set[int], position_m: FloatArray, still_m: float, noise_m: float
) -> list[tuple[int, int]]:
    """Return the part of each hold in which its contact rests, by the noise of these parts alone.

    That is the noise that the check of the dataset sees; where contacts slide in turns, that of whole holds is larger.
    """
    holds = [position_m[span.hold : span.hold_stop] for span in found.spans]
    parts: list[tuple[int, int]] = []
    for _ in range(TRIES):
        parts = [
            _rest(hold, still_m, noise_m) if span.number in sliding else (0, len(hold))
            for span, hold in zip(found.spans, holds, strict=True)
        ]
        left = [hold[start:stop] for hold, (start, stop) in zip(holds, parts, strict=True)]
        seen = sample_noise_m(left)
        if not any(slide_m(part, seen) > still_m for part in left):
            break
        noise_m = min(seen, noise_m)
    return parts


def _rest(position_m: FloatArray, still_m: float, noise_m: float) -> tuple[int, int]:
    """Return the longest part of a hold in which the contact rests, also by the noise of that part alone."""
    start, stop = 0, len(position_m)
    while slide_m(position_m[start:stop], noise_m) > still_m:
        # A part is smoothed less than what it is a part of, and may slide by its own measure.
        first, last = rests(position_m[start:stop], still_m, noise_m)
        start, stop = start + first, start + last
    return start, stop
