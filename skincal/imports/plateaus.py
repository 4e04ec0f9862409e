"""Staircases: contacts in which the force stands still several times; each such plateau is a press.

The rule: the force stands still while it changes by less than ``slope_n_per_s``, measured over ``window_s``. A plateau
lasts ``min_hold_s`` or longer. The ramp before it belongs to it: loading where the force rises, with the branch
``up``; else unloading, with the branch ``down``. Unloading follows the last plateau.
"""

from __future__ import annotations

import numpy as np

from skincal.imports.mapping_file import CutRules
from skincal.imports.recording import FloatArray
from skincal.imports.series import Cut, Rejected, Series, Span, runs


def cut_plateaus(series: Series, rules: CutRules, contacts: list[tuple[int, int]]) -> Cut:
    """Return the plateaus of every contact."""
    spans: list[Span] = []
    rejected: list[Rejected] = []
    for start, stop in contacts:
        time, force = series.time_s[start:stop], series.force_n[start:stop]
        still = np.abs(slopes(time, force, rules.window_s)) < rules.slope_n_per_s
        found = [run for run in runs(still & (force > rules.on_n)) if _lasts(time, run, rules)]
        if not found:
            why = f"no plateau of {rules.min_hold_s:g} s below {rules.slope_n_per_s:g} N/s"
            rejected.append(Rejected(start, stop, why))
        begin, before = start, 0.0
        for i, (first, last) in enumerate(found):
            hold = int(np.count_nonzero(time[:last] < time[first] + rules.settle_s))
            level = float(np.median(force[hold:last]))
            end = stop if i == len(found) - 1 else start + last
            rising = level > before
            branch = "up" if rising else "down"
            spans.append(Span(len(spans), begin, start + hold, start + last, end, rising, branch))
            begin, before = end, level
    return Cut(tuple(spans), tuple(rejected))


def slopes(time_s: FloatArray, force_n: FloatArray, window_s: float) -> FloatArray:
    """Return the change of force over a window around each sample [N/s], shape (n,); a shorter one at the ends.

    Args:
        time_s: times, ascending [s], shape (n,).
        force_n: forces [N], shape (n,).
        window_s: width of the window [s].
    """
    if len(time_s) < 2:
        return np.full(len(time_s), np.inf)
    early = np.maximum(time_s - window_s / 2, time_s[0])
    late = np.minimum(time_s + window_s / 2, time_s[-1])
    change = np.interp(late, time_s, force_n) - np.interp(early, time_s, force_n)
    return np.divide(change, late - early, out=np.full(len(time_s), np.inf), where=late > early)


def _lasts(time_s: FloatArray, run: tuple[int, int], rules: CutRules) -> bool:
    return float(time_s[run[1] - 1] - time_s[run[0]]) >= max(rules.min_hold_s + rules.settle_s, 1e-12)
