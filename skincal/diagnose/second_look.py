"""A second look at presses in doubt, once it is known what else is missing: glitches, or taxels that fell silent."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skincal.diagnose.base_fit import Base
from skincal.gap.models import Model
from skincal.gap.robust import with_presses, without_presses
from skincal.gap.silent import presses_of, silent_taxels, with_silent_values, without_silent


def heard_again(base: Base, after: Model) -> Base:
    """A base with the values of taxels that fell silent, those that do with what was named in the model.

    What is missing in the model may look like a silent taxel, or hide one among all that is wrong with a press.

    Args:
        base: as the effects were named about it.
        after: with them.
    """
    m = base.material
    doubted = np.union1d(base.glitches, presses_of(base.silent))
    if not len(doubted):
        return base
    press = m.session.press
    heard = with_silent_values(m.reading, base.silent, m.session)
    whole = with_presses(heard, press, base.glitches)
    found = silent_taxels(after.hypothesis, m.session, whole, m.options, doubted, base.dead)
    known = {one.dead.taxel for one in base.silent}
    silent = tuple(s for s in found if s.dead.taxel in known or np.isin(s.presses, doubted).all())
    # What was out of proportion, and is not explained by a silent taxel after all, is a glitch again.
    left_out = np.setdiff1d(np.union1d(base.glitches, base.suspected), presses_of(silent))
    reading = with_presses(heard, press, np.intersect1d(base.glitches, presses_of(silent)))
    reading = with_silent_values(without_silent(reading, silent, m.session), silent, m.session)
    reading = without_presses(reading, press, left_out)
    return replace(base, material=replace(m, reading=reading), glitches=left_out, silent=silent)
