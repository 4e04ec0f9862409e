"""Presses that are numbered by a column of the source, with phases from another column or from the force."""

from __future__ import annotations

from collections import Counter
from itertools import pairwise

import numpy as np

from skincal.dataset import HOLD, PHASES
from skincal.dataset.findings import Findings, listed
from skincal.imports.cutting import hold_of
from skincal.imports.mapping_file import CutRules
from skincal.imports.recording import Column
from skincal.imports.series import Cut, Rejected, Series, Span


def cut_numbered(series: Series, rules: CutRules, file: str, findings: Findings) -> Cut:
    """Return one press per number; a number that recurs later is an error."""
    assert series.press is not None
    changes = np.flatnonzero((np.diff(series.press) != 0) | (np.diff(series.part) != 0)) + 1
    edges = np.concatenate([[0], changes, [len(series)]]).astype(np.int64)
    stretches = [(int(a), int(b)) for a, b in pairwise(edges) if series.press[a] >= 0]
    numbers = [int(series.press[start]) for start, _ in stretches]
    again = sorted(number for number, count in Counter(numbers).items() if count > 1)
    if again:
        fix = "Renumber them, or remove [columns.press] and cut by force."
        findings.error(
            f"{file}, press",
            "each press in one stretch of rows",
            f"{listed(again[:6], len(again))} again later",
            fix,
        )
    found = [_span(series, rules, n, *stretch) for n, stretch in zip(numbers, stretches, strict=True)]
    spans = tuple(item for item in found if isinstance(item, Span))
    return Cut(spans, tuple(item for item in found if isinstance(item, Rejected)))


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
    hold = hold_of(series.time_s[first:last], series.force_n[first:last], rules)
    if isinstance(hold, str):
        return Rejected(start, stop, hold)
    return Span(number, first, first + hold[0], first + hold[1], last)


def check_phases(phase: Column, file: str, findings: Findings) -> None:
    """Add an error for words that are not phases."""
    strange = sorted({str(word) for word in phase} - set(PHASES))
    if strange:
        fix = f'Add words = {{ {strange[0] or chr(39) * 2} = "{PHASES[0]}", … }} to [columns.phase].'
        findings.error(
            f"{file}, phase", f"one of {', '.join(PHASES)}", listed(strange[:6], len(strange)), fix
        )
