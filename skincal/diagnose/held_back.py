"""Before and after on the presses that were kept for the end."""

from __future__ import annotations

import numpy as np

from skincal.diagnose.base_fit import Base
from skincal.diagnose.prepare import FINAL, Prepared, force_variance
from skincal.gap.choice import Choice
from skincal.gap.dying import NAME as DEAD_TAXEL
from skincal.gap.faults import without_stuck
from skincal.gap.heldout import Gap, gap_closed
from skincal.gap.hypothesis import Hypothesis
from skincal.gap.reading import Reading
from skincal.gap.relocate import at_best
from skincal.gap.robust import SURE, without_jumps
from skincal.inference.session import GapSession
from skincal.gap.silent import Silent, with_silent_values, without_silent


def ends_of(ready: Prepared, base: Base, choice: Choice) -> tuple[Hypothesis, Hypothesis]:
    """Before and after, every press at its best place: those of the end had no say in when a fit was done."""
    reading = without_silent_ones(ready, base, choice, base.material.reading, ready.session)
    before = at_best(choice.before.hypothesis, ready.session, reading, ready.options)
    if choice.after is choice.before:
        return before, before
    return before, at_best(choice.after.hypothesis, ready.session, reading, ready.options)


def gap_at_the_end(
    ready: Prepared,
    base: Base,
    choice: Choice,
    ends: tuple[Hypothesis, Hypothesis],
    rng: np.random.Generator,
) -> Gap:
    """Before and after on the presses that were kept for the end; glitches are not looked at."""
    rows = (ready.split.part[np.maximum(ready.full.press, 0)] == FINAL) & (ready.full.press >= 0)
    rows &= ~np.isin(ready.full.press, base.glitches)
    reading = without_jumps(ready.full_reading, ready.full, list(base.jumps))
    reading = without_stuck(reading, ready.full, list(base.stuck))
    reading = without_silent_ones(ready, base, choice, reading, ready.full)
    reading = reading.with_further(force_variance(choice.after.hypothesis, ready.full, ready.force_noise_n))
    return gap_closed(*ends, ready.full, reading, rows, rng)


def without_silent_ones(
    ready: Prepared, base: Base, choice: Choice, reading: Reading, session: GapSession
) -> Reading:
    """A reading without what has shown that taxels fell silent, where those were presses of the end."""
    reading = without_silent(reading, base.silent, session)
    return with_silent_values(reading, known_before_the_end(ready, base, choice), session)


def known_before_the_end(ready: Prepared, base: Base, choice: Choice) -> list[Silent]:
    """Taxels that are named, and that presses of the end show to be silent, as others have surely shown before."""
    if DEAD_TAXEL not in choice.after.names:
        return []
    end = [(one, ready.split.part[one.presses] == FINAL) for one in base.silent]
    return [one for one, last in end if min(one.falls[last].sum(), one.falls[~last].sum()) > SURE]
