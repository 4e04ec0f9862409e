"""The base model about a session: fitted with every press's place, without what must not sway a verdict."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from skincal.diagnose.prepare import FINAL, OFFSET, SELECTION, TRAIN, Prepared, force_variance
from skincal.gap.apart import own_variance
from skincal.gap.faults import Stuck, jumps_under_load, rests_rarely, stuck_taxels, without_stuck
from skincal.gap.hypothesis import Hypothesis, Parameters
from skincal.gap.law import law_directions
from skincal.gap.models import Material, Model, excess_of, found_again, scene_of
from skincal.gap.null import law_errors
from skincal.gap.problem import RefitOptions
from skincal.gap.reading import Reading
from skincal.gap.refit import Refit, refit
from skincal.gap.relocate import relocated
from skincal.gap.robust import (
    Dead,
    Jump,
    dead_taxels,
    dominating,
    explained,
    glitches,
    jumps,
    of_neither,
    others_differ,
    without_jumps,
    without_presses,
)
from skincal.gap.silent import MOST_SILENT, Silent, presses_of, silent_taxels, without_silent
from skincal.gap.twin import twins_for
from skincal.model.arrays import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class Base:
    """The base model about a session, and what must not sway a verdict taken out.

    Attributes:
        model: fitted to the presses that learn and choose.
        material: the session, split.
        glitches: rows of presses that were left out.
        dead: taxels that do not answer.
        jumps: of levels, allowed for.
        stuck: taxels that sit at a bound for a while; not believed then.
        silent: taxels that fall silent late; not believed from then on.
        suspected: rows of presses that looked like glitches but for a silent taxel.
    """

    model: Model
    material: Material
    glitches: IntArray
    dead: tuple[Dead, ...]
    jumps: tuple[Jump, ...]
    stuck: tuple[Stuck, ...] = ()
    silent: tuple[Silent, ...] = ()
    suspected: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))


def fit_base(ready: Prepared, *, leave_out: bool = True, late: Sequence[Silent] = ()) -> Base:
    """Fits the base model, and again with the noise of the force, and without glitches and jumps.

    Args:
        ready: the session.
        leave_out: whether presses may be left out as glitches; those of the end may in any case.
        late: taxels that were seen to fall silent once it was known what else is missing.
    """
    known, beside, session = ready.is_part(TRAIN, SELECTION), _beside(ready), ready.session
    reading, stuck, shifted = _of_staircase(ready, beside)
    # Where all taxels feel the same, what one of them does alone is noise for effects that are equations for all.
    alone = np.zeros(reading.trust.shape[1]) if ready.options.base else own_variance(session, reading, known)
    reading = reading.with_further(np.broadcast_to(alone, reading.trust.shape))
    first = _first_look(ready, reading, beside)
    wild = glitches(first.slopes.residual, reading.seen, session.press)
    if not leave_out:
        wild = wild[ready.split.part[wild] == FINAL]
    whole, reading = reading, without_presses(reading, session.press, wild)
    if len(wild):
        # They have drawn sensor and places after them: from the beginning, without them.
        first = _first_look(ready, reading, beside)
    gone = dead_taxels(first.slopes.values, reading, session)
    new = silent_taxels(first.hypothesis, session, whole, ready.options, wild, gone)
    new += [one for one in late if one.dead.taxel not in {s.dead.taxel for s in new}]
    silent: list[Silent] = []
    doubted = wild
    while new:
        silent += new
        wild = np.setdiff1d(doubted, presses_of(silent))
        reading = without_presses(whole, session.press, wild)
        first = _first_look(ready, without_silent(reading, silent, session), beside)
        # One that fell silent beside another shows once that one draws no press elsewhere any more.
        believed = without_silent(whole, silent, session)
        dumb = [*gone, *(one.dead for one in silent)]
        new = silent_taxels(first.hypothesis, session, believed, ready.options, wild, dumb)
        if len(silent) + len(new) > reading.trust.shape[1] // MOST_SILENT:
            break  # So many more are something else; those that were found before stay.
    suspected = np.intersect1d(doubted, presses_of(silent))
    reading = reading.with_further(alone + force_variance(first.hypothesis, session, ready.force_noise_n))
    values, quiet = first.slopes.values, without_silent(reading, silent, session)
    if not rests_rarely(session):
        stuck = stuck_taxels(values, quiet, session)
        reading, quiet = (without_stuck(r, session, stuck) for r in (reading, quiet))
    dead = dead_taxels(values, quiet, session)
    jumped = [*shifted, *jumps(values, quiet, session, dead)]
    # What is not believed any more is kept: it is looked at again once all else is known.
    reading = without_silent(without_jumps(reading, session, jumped[len(shifted) :]), silent, session)
    options = replace(ready.options, settle=0)
    first = _fitted_beside(ready, first.hypothesis, reading, known, options)
    learn, score = ready.is_part(TRAIN), ready.is_part(SELECTION)
    material = Material(session, reading, learn, score, ready.options)
    # Models with effects have their presses looked for again; what they are compared with deserves the same.
    model = found_again(Model(first, (), ready.known_effects), material)
    return Base(model, material, wild, tuple(dead), tuple(jumped), tuple(stuck), tuple(silent), suspected)


def _fitted_beside(
    ready: Prepared, start: Hypothesis, reading: Reading, known: BoolArray, options: RefitOptions
) -> Refit:
    """The base model's fit beside a high level at rest, which is not in the model that comes out."""
    session, beside = ready.session, _beside(ready)
    found = refit(start, session, reading, options, learn=known, fixed=beside)
    if beside is ready.known_effects:
        return found
    still = replace(options, steps=0)
    return refit(found.hypothesis, session, reading, still, learn=known, fixed=ready.known_effects)


def _of_staircase(ready: Prepared, beside: dict[str, Parameters]) -> tuple[Reading, list[Stuck], list[Jump]]:
    """The reading without what fails on a staircase, found at the calibration: a fit would bend the forces to it."""
    session, reading = ready.session, ready.reading
    if not rests_rarely(session):
        return reading, [], []
    values = ready.start.with_effects(beside).values(session)
    stuck = stuck_taxels(values, reading, session)
    reading = without_stuck(reading, session, stuck)
    shifted = jumps_under_load(values, reading, session)
    return without_jumps(reading, session, shifted), stuck, shifted


def _beside(ready: Prepared) -> dict[str, Parameters]:
    """Effects that the base model is fitted beside: those of the calibration, and a level at rest that is high.

    Such a level is not the base model's and is named like any other effect; but left out of the fit, it would move
    sensor, places and forces as far as they go.
    """
    if ready.rest_counts is None:
        return ready.known_effects
    return {**ready.known_effects, OFFSET: {"offset_counts": ready.rest_counts}}


def _first_look(ready: Prepared, reading: Reading, beside: dict[str, Parameters]) -> Refit:
    """The base model's fit, with presses that it left in the wrong valley found again."""
    known, session = ready.is_part(TRAIN, SELECTION), ready.session
    first = refit(ready.start, session, reading, ready.options, learn=known, fixed=beside)
    placed = relocated(first.hypothesis, session, reading, ready.options)
    if placed is first.hypothesis:
        return first
    options = replace(ready.options, settle=0)
    return refit(placed, session, reading, options, learn=known, fixed=beside)


def _law_errors(base: Base, heard: Callable[[str], None]) -> dict[str, FloatArray]:
    """What each contact law leaves of the base model (N, J), whitened; the fitted one nothing."""
    twins = twins_for(base.model.hypothesis, base.material.session)
    heard(f"null sessions: {', '.join(twin.name for twin in twins)}")
    nothing = {"fitted": np.zeros_like(base.model.refit.slopes.values)}
    return nothing | law_errors(scene_of(base.model, base.material), base.material, twins)


def fit_base_and_law(
    ready: Prepared,
    heard: Callable[[str], None],
    *,
    leave_out: bool = True,
    late: Sequence[Silent] = (),
) -> tuple[Base, dict[str, FloatArray]]:
    """The base model beside what its law may be wrong in, and what each contact law leaves of it (N, J).

    Args:
        ready: the session.
        heard: told what is being done.
        leave_out: whether presses may be left out of fit and choice as glitches.
        late: taxels that were seen to fall silent once it was known what else is missing.
    """
    base = fit_base(ready, leave_out=leave_out, late=late)
    errors = _law_errors(base, heard)
    base = with_law(base, errors)
    alone = dominating(*_left(base.model, base.material))
    if leave_out and len(alone):
        base = _without(ready, base, alone)
        errors = _law_errors(base, heard)
        base = with_law(base, errors)
    return base, errors


def may_be_effect(base: Base) -> bool:
    """Whether presses were left out of fit and choice as glitches, though others differ as well."""
    m = base.material
    left_out = np.isin(base.glitches, m.session.press[m.known]).any()
    return bool(left_out) and others_differ(*_left(base.model, m))


def explains(model: Model, base: Base, presses: IntArray) -> bool:
    """Whether some presses are no glitches under a model, beside a base of which they were not left out."""
    before, seen, press = _left(base.model, base.material)
    return explained(before, _left(model, base.material)[0], seen, press, presses)


def without_hidden_glitches(base: Base, after: Model) -> Base:
    """A base without presses that are still out of all proportion once what was missing is in the model.

    Only presses that were kept for the end are left out: the others had their say already.
    """
    m = base.material
    seen, press = m.reading.seen, m.session.press
    wild = of_neither(base.model.refit.slopes.residual, after.refit.slopes.residual, seen, press)
    hidden = wild[~np.isin(wild, press[m.known]) & ~np.isin(wild, presses_of(base.silent))]
    if not len(hidden):
        return base
    reading = without_presses(m.reading, press, hidden)
    return replace(base, material=replace(m, reading=reading), glitches=np.union1d(base.glitches, hidden))


def _left(model: Model, m: Material) -> tuple[FloatArray, BoolArray, IntArray]:
    """What a model leaves (n, J), whitened and projected, of what choice and fit see; where read; the presses."""
    view = scene_of(model, m).part(m.known)
    seen = m.reading.seen[view.rows]
    return view.residual.reshape(seen.shape), seen, m.session.press[view.rows]


def _without(ready: Prepared, base: Base, presses: IntArray) -> Base:
    """A base without presses that were found in it."""
    m = base.material
    reading = without_presses(m.reading, m.session.press, presses)
    options = replace(m.options, settle=0)
    fitted = _fitted_beside(ready, base.model.hypothesis, reading, m.known, options)
    return replace(
        base,
        model=replace(base.model, refit=fitted),
        material=replace(m, reading=reading),
        glitches=np.union1d(base.glitches, presses),
    )


def with_law(base: Base, errors: Mapping[str, FloatArray]) -> Base:
    """A base whose contact law may err as twins do."""
    # Directions that are there already would be projected out, and nothing be left of any law.
    bare = scene_of(base.model, replace(base.material, law=None))
    law = law_directions(bare, base.material.known, list(errors.values()))
    if not base.material.options.base:
        law = np.concatenate([law, _own_scales(base.model.refit.slopes.base[..., -1])], axis=-1)
    return replace(base, material=replace(base.material, law=law))


def _own_scales(slopes: FloatArray) -> FloatArray:
    """Directions (N, J, J) of the scale of each taxel, from whitened slopes (N, J) by the logarithm of S.

    Uniform pressure has told them, as a fit tells pose and S otherwise: their errors are not effects.
    """
    return slopes[:, :, None] * np.eye(len(slopes[0]))


def of_law(base: Base) -> float:
    """Root mean square of what the law's own error explains, in units of the noise; nothing shows it in a chamber."""
    if not base.material.options.base:
        return 0.0
    without = excess_of(base.model, replace(base.material, law=None), 0.0)
    values = int((base.material.reading.seen & base.material.known[:, None]).sum())
    return float(np.sqrt(max(without - excess_of(base.model, base.material, 0.0), 0.0) / values))
