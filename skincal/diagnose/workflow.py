"""The diagnosis, stage by stage: noise, where, what can be seen, what is missing, add it, show the gap shrink.

The base model is fitted again with every press's place, on the presses that learn and choose; a calibration that was
fitted to all of them has then no advantage. Null sessions say which scores nothing can reach. Effects are named one by
one. What was named is fitted once more to all presses for the calibration that comes out, but not for the gap.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skincal.calibrate.workers import mapper
from skincal.calibration import Calibration
from skincal.calibration.matching import check_same_sensor
from skincal.dataset import Dataset
from skincal.diagnose.answer import Question
from skincal.diagnose.audit import audit_dataset
from skincal.diagnose.base_fit import Base, of_law, without_hidden_glitches
from skincal.diagnose.cache import Cache
from skincal.diagnose.diagnosis import Diagnosis, NamedEffect
from skincal.diagnose.findings import (
    few_of_the_end,
    findings_of,
    of_noise,
    too_many_glitches,
    within_the_clocks,
)
from skincal.diagnose.fitted_presses import with_fitted_presses
from skincal.diagnose.newcal import new_calibration
from skincal.diagnose.next_presses import with_next_presses
from skincal.diagnose.options import DiagnoseOptions
from skincal.diagnose.own_numbers import numbers_differ, scales_differ
from skincal.diagnose.prepare import FINAL, OFFSET, Prepared, force_variance, prepare
from skincal.diagnose.session import repeats
from skincal.effects import EFFECTS
from skincal.fit.tasks import Mapper
from skincal.gap.choice import Choice, Named
from skincal.gap.contest import Heard
from skincal.gap.dying import NAME as DEAD_TAXEL
from skincal.gap.faults import without_stuck
from skincal.gap.free import parameters_at
from skincal.gap.heldout import Gap, gap_closed
from skincal.gap.hypothesis import Hypothesis
from skincal.gap.models import Model
from skincal.gap.places import NAME as PLACES
from skincal.gap.reading import Reading
from skincal.gap.refit import refit
from skincal.gap.relocate import at_best
from skincal.gap.robust import SURE, too_many, without_jumps
from skincal.gap.session import GapSession
from skincal.gap.signatures import where_text
from skincal.gap.silent import Silent, with_silent_values, without_silent
from skincal.model.arrays import IntArray

_WIDTH = 1.96
_FITS = 1000
"""Ends of fits that are kept: those of a few diagnoses, so that one that was interrupted goes on."""
_PULLED = 16.0
"""A press that has so many standard deviations of its measured force more, or less, is told."""


def diagnose(
    dataset: Dataset,
    calibration: Calibration,
    options: DiagnoseOptions | None = None,
    seed: int = 0,
    heard: Heard = lambda _: None,
    cache: Cache | None = None,
    workers: int | None = 1,
) -> Diagnosis:
    """Finds what a calibrated simulation lacks against a dataset.

    Args:
        dataset: the session.
        calibration: of the same sensor; effects that it has already are kept.
        options: settings.
        seed: of all chance.
        heard: told which stage begins.
        cache: of what was worked out before; None: nothing is kept.
        workers: processes for what can be done side by side; None for one a core, or none but this one where there are
            no frames and little to do. The result does not depend on it, beyond the rounding of linear algebra that
            has several threads in this process.

    Raises:
        InputError: the calibration is of another sensor.
        WorkError: too few presses, or presses that all left the same image.
    """
    check_same_sensor(calibration, dataset)
    with mapper(1 if workers is None and dataset.frames is None else workers) as spread:
        found = _diagnosed(dataset, calibration, options or DiagnoseOptions(), seed, heard, cache, spread)
        # The processes end here: what is fitted later is fitted without them.
        return replace(found, material=found.material.alone)


def _diagnosed(
    dataset: Dataset,
    calibration: Calibration,
    options: DiagnoseOptions,
    seed: int,
    heard: Heard,
    cache: Cache | None,
    spread: Mapper,
) -> Diagnosis:
    # A generator for each use: what is taken from a cache must not change what comes after it.
    rng, audited, asked, again, further = np.random.default_rng(seed).spawn(5)
    heard("noise floor and places")
    ready = prepare(dataset, calibration, options, rng)
    cache = cache or Cache()
    fits = cache.beside("fits", _FITS)
    ready = replace(ready, options=replace(ready.options, mapper=spread, keep=fits.get))
    heard("what can be seen")
    audit = audit_dataset(dataset, calibration, audited)
    floor = ready.floor.with_repeats_of(audit.floor)
    answer = Question(ready, dataset.layout(), options, seed, cache, heard).answer(asked)
    choice = answer.choice
    base = without_hidden_glitches(answer.base, choice.after) if choice.named else answer.base
    heard("gap on presses nobody has fitted")
    before, after = _ends(ready, base, choice)
    gap = _gap(ready, base, choice, (before, after), again)
    by_the_fault = answer.seen_only and not _known_before_the_end(ready, base, choice)
    if by_the_fault:
        # What would show the gap has shown the fault.
        gap = replace(gap, closed=float("nan"), interval=(float("nan"), float("nan")))
    # The weakest effect is one of what was fitted; the gap is that of frames.
    of_frames = _deviation(choice.after, base) / gap.floor
    refuted = answer.verdict == "effects" and gap.refutes(options.choice.weakest * of_frames)
    refuted = refuted and not (by_the_fault or _only_places(choice))
    if refuted:
        # It adds as much to presses that nobody has fitted as the weakest effect does: it is not what is missing.
        answer = replace(answer, verdict="unknown", unexplained=True)
    # What effects do may look like another law as long as they are not in the model.
    law = min(choice.law, of_law(replace(base, model=choice.after)))
    wide_open = answer.verdict == "effects" and gap.stays_open(law * of_frames) and not _beside_images(choice)
    if wide_open:
        # It is there, but it is not the gap: levels at rest of a few hundredths of a count, for one.
        answer = replace(answer, verdict="unknown", unexplained=True)
    named = answer.verdict == "effects"
    effects = _named(choice, ready, base, dataset) if named else ()
    heard_of, known = without_silent(base.material.reading, base.silent, ready.session), base.material.known
    if ready.options.base:
        other = numbers_differ(calibration, dataset, ready, after if named else before, heard_of, known)
    else:
        other = scales_differ(calibration, dataset, ready, heard_of, known)
    heard("calibration")
    final = calibration
    if named:
        final = _refitted(ready, base, choice, after, calibration, dataset, answer.unexplained)
    wild = too_many(
        (choice.after if named else choice.before).refit.slopes.residual,
        heard_of.seen & known[:, None],
        ready.session.press,
    )
    found = Diagnosis(
        answer.verdict,
        effects,
        answer.unexplained,
        _where(base, base.model, dataset),
        gap,
        floor,
        audit,
        answer.null,
        choice,
        answer.signatures,
        other
        + of_noise(
            floor,
            frames=ready.session.has_frames,
            repeated=_repeated(dataset),
            uniform=not ready.options.base,
        )
        + few_of_the_end(gap)
        + within_the_clocks(effects, None if dataset.meta.clock is None else dataset.meta.clock.sigma_s)
        + too_many_glitches(dataset.presses.press, wild)
        + findings_of(
            dataset.layout(),
            dataset.presses.press,
            base.glitches.tolist(),
            base.jumps,
            [*base.dead, *(one.dead for one in base.silent)],
            ready.reading.seen,
            ready.session.taxels,
            law if named else choice.law,
            base.stuck,
            dataset.presses.counts.shape[1],
            answer.doubted.tolist(),
            _pulled(after if named else before, ready, base.glitches),
            (ready.floor.frame_counts, ready.floor.taxel_counts),
            None if ready.session.samples.time_s is not None else ready.session.press,
            of_single=[e.name for e in effects if _has_numbers_of_taxels(e) and not _of_all(e, ready)],
        ),
        ready.split,
        ready.session,
        base.material,
        final,
        options,
        seed,
        refuted=refuted,
        wide_open=wide_open,
    )
    heard("next presses")
    return with_next_presses(found, dataset, further)


def _repeated(dataset: Dataset) -> bool | None:
    """Whether any press is an exact repeat of another; None where no targets tell."""
    names = ("target_force_n", "target_x_m", "target_y_m", "target_z_m")
    targets = [c for name in names if (c := dataset.presses.column(name)) is not None]
    if len(targets) < len(names) or not np.isfinite(np.stack(targets)).all(axis=0).any():
        return None
    return bool(len(repeats(dataset)[0]))


def _beside_images(choice: Choice) -> bool:
    """Whether all that is named is told by other things than images: places, or taxels that are dead."""
    return all(one.name in (PLACES, DEAD_TAXEL) for one in choice.named)


def _only_places(choice: Choice) -> bool:
    """Whether all that is named lives in the places, so that images say nothing for it or against it."""
    return all(one.by_places for one in choice.named)


def _ends(ready: Prepared, base: Base, choice: Choice) -> tuple[Hypothesis, Hypothesis]:
    """Before and after, every press at its best place: those of the end had no say in when a fit was done."""
    reading = _of_silent(ready, base, choice, base.material.reading, ready.session)
    before = at_best(choice.before.hypothesis, ready.session, reading, ready.options)
    if choice.after is choice.before:
        return before, before
    return before, at_best(choice.after.hypothesis, ready.session, reading, ready.options)


def _gap(
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
    reading = _of_silent(ready, base, choice, reading, ready.full)
    reading = reading.with_further(force_variance(choice.after.hypothesis, ready.full, ready.force_noise_n))
    return gap_closed(*ends, ready.full, reading, rows, rng)


def _of_silent(ready: Prepared, base: Base, choice: Choice, reading: Reading, session: GapSession) -> Reading:
    """A reading without what has shown that taxels fell silent, where those were presses of the end."""
    reading = without_silent(reading, base.silent, session)
    return with_silent_values(reading, _known_before_the_end(ready, base, choice), session)


def _known_before_the_end(ready: Prepared, base: Base, choice: Choice) -> list[Silent]:
    """Taxels that are named, and that presses of the end show to be silent, as others have surely shown before."""
    if DEAD_TAXEL not in choice.after.names:
        return []
    end = [(one, ready.split.part[one.presses] == FINAL) for one in base.silent]
    return [one for one, last in end if min(one.falls[last].sum(), one.falls[~last].sum()) > SURE]


def _pulled(after: Hypothesis, ready: Prepared, glitches: IntArray) -> dict[int, float]:
    """Rows of presses that fit best with quite another force, and by which part it is larger than the measured one."""
    if not ready.options.base:
        return {}
    own = np.abs(after.places[:, 2]) > _PULLED * ready.options.force_sigma
    rows = np.setdiff1d(np.flatnonzero(own), glitches)
    return {int(row): float(np.expm1(after.places[row, 2])) for row in rows}


def _named(choice: Choice, ready: Prepared, base: Base, dataset: Dataset) -> tuple[NamedEffect, ...]:
    found: list[NamedEffect] = []
    spread = np.sqrt(
        np.maximum(np.diag(choice.after.refit.covariance)[5:], 0.0)
        * max(1.0, _mean_square(choice.after, base))
    )
    x, coords = choice.after.refit.x, choice.after.coords
    low = parameters_at(coords, x - _WIDTH * spread, choice.after.held)
    high = parameters_at(coords, x + _WIDTH * spread, choice.after.held)
    best = choice.after.hypothesis.effects
    for one in choice.named:
        ends = {
            name: (
                np.minimum(low[one.name][name], high[one.name][name]),
                np.maximum(low[one.name][name], high[one.name][name]),
            )
            for name in best[one.name]
        }
        found.append(
            NamedEffect(
                one.name,
                one.consistent_with,
                one.p_value,
                dict(best[one.name]),
                ends,
                _where_without(one, choice, base, dataset),
                one.share,
                one.by_places,
            )
        )
    return tuple(found)


def _where(base: Base, model: Model, dataset: Dataset) -> str:
    m = base.material
    return where_text(model.refit.slopes.residual, m.reading.seen, m.session, dataset.layout(), m.known)


def _has_numbers_of_taxels(effect: NamedEffect) -> bool:
    return any(p.shape == "per-taxel" for p in EFFECTS[effect.name].parameters)


def _of_all(effect: NamedEffect, ready: Prepared) -> bool:
    """Whether an effect has numbers of all taxels, though some only were looked at."""
    return effect.name == OFFSET and ready.rest_counts is not None


def _where_without(one: Named, choice: Choice, base: Base, dataset: Dataset) -> str:
    """Where the residual lies that is left without one of the effects that were named."""
    if one.by_places:
        return "in where presses turn out to be: images do not show it"
    if sum(not other.by_places for other in choice.named) == 1:
        return _where(base, choice.before, dataset)
    m, after = base.material, choice.after.hypothesis
    others = {name: values for name, values in after.effects.items() if name != one.name}
    residual = np.nan_to_num(m.reading.residual(after.with_effects(others).values(m.session)))
    return where_text(residual, m.reading.seen, m.session, dataset.layout(), m.known)


def _refitted(
    ready: Prepared,
    base: Base,
    choice: Choice,
    start: Hypothesis,
    calibration: Calibration,
    dataset: Dataset,
    unexplained: bool,
) -> Calibration:
    """The calibration with what was named, fitted to all presses from where those of the end were found, too."""
    options = replace(ready.options, settle=0)
    held = dict(choice.after.held)
    if ready.rest_counts is not None and any(one.name == OFFSET for one in choice.named):
        # Of a large sensor only some taxels were looked at; what the others read at rest is known all the same.
        held[OFFSET] = {"offset_counts": ready.rest_counts}
    last = refit(
        start,
        ready.session,
        base.material.reading,
        options,
        choice.after.coords,
        choice.after.refit.x,
        fixed=held,
    )
    seen = base.material.reading.seen
    mean_square = float((last.slopes.residual[seen] ** 2).mean())
    made = new_calibration(calibration, last, choice.after.coords, held, mean_square, dataset, ready.poses)
    return with_fitted_presses(
        made,
        last.hypothesis,
        ready.session,
        base.material.reading,
        dataset,
        base.glitches,
        unexplained=unexplained,
    )


def _deviation(model: Model, base: Base) -> float:
    """Root mean square noise of what was fitted [counts]: of means of some frames, not of single ones as in the gap."""
    m = base.material
    seen = m.reading.seen & m.known[:, None]
    return float(np.sqrt((m.reading.deviation(model.refit.slopes.values)[seen] ** 2).mean()))


def _mean_square(model: Model, base: Base) -> float:
    """What a model leaves of the presses that it was fitted to, in squares of the noise."""
    seen = base.material.reading.seen & base.material.known[:, None]
    return float((model.refit.slopes.residual[seen] ** 2).mean())
