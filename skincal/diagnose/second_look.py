"""A second look at presses in doubt, once it is known what else is missing: glitches, or taxels that fell silent."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skincal.diagnose.base_fit import Base
from skincal.gap.choice import Choice
from skincal.gap.dying import NAME as DEAD_TAXEL
from skincal.gap.faults import without_stuck
from skincal.gap.models import Model, fitted
from skincal.gap.reading import Reading
from skincal.gap.relocate import at_best
from skincal.gap.robust import (
    IN_PROPORTION,
    SURE,
    explained_presses,
    with_presses,
    without_mixed,
    without_presses,
)
from skincal.gap.silent import Silent, presses_of, silent_taxels, with_silent_values, without_silent
from skincal.model.arrays import IntArray


def silent_beside(base: Base, after: Model) -> list[Silent]:
    """Taxels that are seen to fall silent only once what else is missing is in the model.

    They were believed while it was looked for, so that what they do is among what is left. Those that presses in doubt
    show alone are not meant: these had no say.

    Args:
        base: as the effects were named about it.
        after: with them.
    """
    doubted, known = _doubted(base), {one.dead.taxel for one in base.silent}
    new = [one for one in _silent(base, after) if one.dead.taxel not in known and one.fall > SURE]
    return [one for one in new if not np.isin(one.presses, doubted).all()]


def heard_again(base: Base, after: Model) -> Base:
    """A base with the values of taxels that fell silent, those that do with what was named in the model.

    What is missing in the model may look like a silent taxel, or hide one among all that is wrong with a press.

    Args:
        base: as the effects were named about it.
        after: with them.
    """
    m, press, doubted = base.material, base.material.session.press, _doubted(base)
    if not len(doubted):
        return base
    known = {one.dead.taxel for one in base.silent}
    heard = with_silent_values(m.reading, base.silent, m.session)
    silent = tuple(
        s for s in _silent(base, after) if s.dead.taxel in known or np.isin(s.presses, doubted).all()
    )
    # What was out of proportion, and is not explained by a silent taxel after all, is a glitch again.
    left_out = np.setdiff1d(np.union1d(base.glitches, base.suspected), presses_of(silent))
    reading = with_presses(heard, press, np.intersect1d(base.glitches, presses_of(silent)))
    reading = with_silent_values(without_silent(reading, silent, m.session), silent, m.session)
    reading = without_presses(reading, press, left_out)
    return replace(base, material=replace(m, reading=reading), glitches=left_out, silent=silent)


def taken_back(base: Base, choice: Choice) -> tuple[Base, Choice]:
    """A base and a choice with those presses that had been left out as glitches and fit once effects are named.

    An effect that is steep is largest in few presses; without it in the model, these are out of all proportion. Presses
    of the end stay out: those that fit what was named would be chosen by it to say how well it does. What the choice
    says it explained stays what was found without the presses.

    Args:
        base: without its glitches.
        choice: of effects, made about it.
    """
    m = base.material
    session = m.session
    doubted = np.intersect1d(base.glitches, session.press[m.known])
    if not choice.named or not len(doubted):
        return base, choice
    whole = _with(base, doubted)
    ends = [at_best(model.hypothesis, session, whole, m.options) for model in (choice.before, choice.after)]
    # A press beyond the rim of a mesh has no image.
    left = [np.nan_to_num(whole.residual(end.values(session))) for end in ends]
    back = explained_presses(left[0], left[1], whole.seen, session.press, doubted, IN_PROPORTION)
    if not len(back):
        return base, choice
    reading = _with(base, back)
    if DEAD_TAXEL in choice.after.names:
        reading = with_silent_values(reading, base.silent, session)
    material = replace(m, reading=reading)
    # Beside what was read off the base model stays as it is: fitted without that, it would bend to make up for it.
    still = replace(material, options=replace(material.options, steps=0))
    before, after = (
        fitted(end, model.coords, model.refit.x, model.held, of)
        for end, model, of in zip(ends, (choice.before, choice.after), (still, material), strict=True)
    )
    base = replace(base, model=before, material=material, glitches=np.setdiff1d(base.glitches, back))
    return base, replace(choice, before=before, after=after)


def _doubted(base: Base) -> IntArray:
    """Presses that were left out, or show a taxel falling silent."""
    return np.union1d(base.glitches, presses_of(base.silent))


def _silent(base: Base, after: Model) -> list[Silent]:
    """Taxels that fall silent under a model, among all that was read.

    Of several that are silent each draws presses elsewhere while it is believed: so each is listened to by itself, too,
    and others are looked for without them.
    """
    m, press, doubted = base.material, base.material.session.press, _doubted(base)
    whole = with_presses(with_silent_values(m.reading, base.silent, m.session), press, base.glitches)

    def seen(without: list[Silent]) -> list[Silent]:
        reading = without_silent(whole, without, m.session)
        return silent_taxels(after.hypothesis, m.session, reading, m.options, doubted, base.dead)

    found = {one.dead.taxel: one for one in seen([])}
    if len(base.silent) > 1:
        known = [one.dead.taxel for one in base.silent]
        found = {taxel: one for taxel, one in found.items() if taxel in known}
        for taxel in known:
            others = [one for one in base.silent if one.dead.taxel != taxel]
            found |= {one.dead.taxel: one for one in seen(others) if one.dead.taxel == taxel}
        found |= {one.dead.taxel: one for one in seen(list(base.silent)) if one.dead.taxel not in known}
    return [found[taxel] for taxel in sorted(found)]


def _with(base: Base, presses: IntArray) -> Reading:
    """The reading with some of the presses that had been left out, but for taxels that do not answer then."""
    m = base.material
    reading = without_stuck(with_presses(m.reading, m.session.press, presses), m.session, list(base.stuck))
    return without_silent(without_mixed(reading, m.session, base.jumps), base.silent, m.session)
