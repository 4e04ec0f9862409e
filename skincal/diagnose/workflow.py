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
from skincal.diagnose.diagnosis import Diagnosis
from skincal.diagnose.fitted_presses import with_fitted_presses
from skincal.diagnose.held_back import ends_of, gap_at_the_end, known_before_the_end
from skincal.diagnose.listed import listed
from skincal.diagnose.named import named_effects, where_left
from skincal.diagnose.newcal import new_calibration
from skincal.diagnose.next_presses import with_next_presses
from skincal.diagnose.options import DiagnoseOptions
from skincal.diagnose.own_numbers import numbers_differ, scales_differ
from skincal.diagnose.prepare import OFFSET, Prepared, prepare
from skincal.fit.tasks import Mapper
from skincal.gap.choice import Choice
from skincal.gap.contest import Heard
from skincal.gap.dying import NAME as DEAD_TAXEL
from skincal.gap.hypothesis import Hypothesis
from skincal.gap.models import Model
from skincal.gap.places import NAME as PLACES
from skincal.gap.refit import refit
from skincal.gap.silent import without_silent

_FITS = 1000
"""Ends of fits that are kept: those of a few diagnoses, so that one that was interrupted goes on."""


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
    before, after = ends_of(ready, base, choice)
    gap = gap_at_the_end(ready, base, choice, (before, after), again)
    by_the_fault = answer.seen_only and not known_before_the_end(ready, base, choice)
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
    effects = named_effects(choice, base, dataset) if named else ()
    last = (choice.after, after) if named else (choice.before, before)
    heard_of, known = without_silent(base.material.reading, base.silent, ready.session), base.material.known
    if ready.options.base:
        other = numbers_differ(calibration, dataset, ready, last[1], heard_of, known)
    else:
        other = scales_differ(calibration, dataset, ready, heard_of, known)
    heard("calibration")
    final = calibration
    if named:
        final = _refitted(ready, base, choice, after, calibration, dataset, answer.unexplained)
    found = Diagnosis(
        answer.verdict,
        effects,
        answer.unexplained,
        where_left(base, base.model, dataset),
        gap,
        floor,
        audit,
        answer.null,
        choice,
        answer.signatures,
        other
        + listed(
            dataset, ready, base, answer, effects, floor, gap, last, heard_of, law if named else choice.law
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


def _beside_images(choice: Choice) -> bool:
    """Whether all that is named is told by other things than images: places, or taxels that are dead."""
    return all(one.name in (PLACES, DEAD_TAXEL) for one in choice.named)


def _only_places(choice: Choice) -> bool:
    """Whether all that is named lives in the places, so that images say nothing for it or against it."""
    return all(one.by_places for one in choice.named)


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
