"""Taxels that do not answer: as a start of the search for ``dead_taxel``, and named without one.

Two or three presses, the last ones of a session, leave nothing to choose with. A taxel that they show falling silent
(:mod:`skincal.gap.silent`) was seen to die: it is left out of the search for other effects and named after it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from skincal.effects import EFFECTS
from skincal.gap.candidates import Bench, Found, Start
from skincal.gap.choice import Choice, Named
from skincal.gap.free import Coordinate, coordinates
from skincal.gap.models import Material, Model, extended, fitted, scene_of
from skincal.gap.null import Null
from skincal.gap.robust import Dead
from skincal.gap.silent import Silent

NAME = "dead_taxel"


def dead_start(bench: Bench, dead: Sequence[Dead]) -> Start | None:
    """How much each dead taxel answers and what it reads, from the moment that was found; None without any."""
    if not dead or NAME in bench.hypothesis.effects:
        return None
    if "time" in bench.lacking:
        # The effect cannot say since when then: one that died would be dead from the beginning.
        dead = [one for one in dead if one.from_s <= 0]
        if not dead:
            return None
    flat = {_flat(one, bench): one for one in dead}
    from_s = np.zeros(bench.sizes["per-taxel"])
    for taxel, one in flat.items():
        from_s[taxel] = one.from_s
    coords: list[Coordinate] = []
    x: list[float] = []
    for c in coordinates(EFFECTS[NAME], bench.sizes, bench.lacking):
        one = flat.get(c.index)
        if one is None or c.parameter.name == "from_s":
            continue
        if c.is_strength:
            coords.append(c)
            x.append((one.answer - c.start) / c.unit)
        else:
            coords.append(
                replace(c, start=float(np.clip(one.stuck_counts, c.parameter.low, c.parameter.high)))
            )
            x.append(0.0)
    lasting = {} if "time" in bench.lacking else {NAME: {"from_s": from_s}}
    return Start(NAME, tuple(coords), lasting, tuple(x))


def with_silent(choice: Choice, silent: Sequence[Silent], material: Material, null: Null) -> Choice:
    """A choice with taxels that were seen to fall silent named as well.

    It is the same where dead ones were named before. Without a clock, which the effect needs to say since when, only
    those are named that never answered. What is left stays that of the choice, in which the silent have no part.

    Args:
        choice: made without the values of those taxels.
        silent: they.
        material: the session with those values.
        null: sessions in which nothing is missing.
    """
    if not silent:
        return choice
    bench = scene_of(choice.after, material).bench
    if "time" in bench.lacking:
        silent = [one for one in silent if one.dead.from_s <= 0]
    start = dead_start(bench, [one.dead for one in silent])
    if start is None:
        return choice
    seen = _as_seen(start, {_flat(one.dead, bench) for one in silent if not _learned(one, material)})
    found = Found(seen, np.zeros(len(seen.coords)), 0.0, 0.0)
    before, after = _looked_at(choice.before, material), _looked_at(choice.after, material)
    model = extended(after, found, material)
    fall = sum(one.fall for one in silent)
    share = sum(one.fall * one.share for one in silent) / fall
    named = (*choice.named, Named(NAME, (NAME,), share, null.p_value(NAME, fall)))
    return replace(choice, before=before, after=model, named=named)


def _learned(one: Silent, material: Material) -> bool:
    """Whether a press that shows a taxel to be silent has a say in fits."""
    return bool(material.known[np.isin(material.session.press, one.presses)].any())


def _as_seen(start: Start, held: set[int]) -> Start:
    """A start from which fits begin at what was seen, and which says so of some taxels for good.

    Presses of the end have no say in a fit. Where they alone show that a taxel is silent, what the others say of it are
    hundredths of a count.
    """
    seen = tuple(replace(c, start=c.value(x)) for c, x in zip(start.coords, start.x, strict=True))
    lasting = {key: np.array(value) for key, value in start.held.get(NAME, {}).items()}
    for c in seen:
        if c.index in held:
            own = lasting.setdefault(c.parameter.name, np.full(c.size, c.parameter.neutral))
            own[c.index] = c.start
    free = tuple(c for c in seen if c.index not in held)
    return replace(start, coords=free, held={NAME: lasting} if lasting else {}, x=(0.0,) * len(free))


def _flat(one: Dead, bench: Bench) -> int:
    """Number of a dead taxel among those of the layout."""
    looked = bench.session.taxels
    return one.taxel if looked is None else int(looked[one.taxel])


def _looked_at(model: Model, material: Material) -> Model:
    """A model as it is, with what it leaves of material that it was not fitted to."""
    still = replace(material, options=replace(material.options, steps=0))
    return fitted(model.hypothesis, model.coords, model.refit.x, model.held, still)
