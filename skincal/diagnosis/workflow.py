"""The diagnosis, stage by stage: fit the base model, search, check, look once at the presses of the end, calibrate."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from skincal.calibrate.data_findings import findings_of_check, is_corrupted, search_for_order
from skincal.calibration import Calibration
from skincal.calibration.matching import check_same_sensor
from skincal.dataset import Dataset
from skincal.diagnosis.audit import report_of
from skincal.diagnosis.diagnosis import Diagnosis, NamedEffect
from skincal.diagnosis.gap import gap_of, placed_presses
from skincal.diagnosis.newcal import effect_intervals, new_calibration
from skincal.diagnosis.next_presses import MOST, next_presses
from skincal.diagnosis.observed import Observed, observe
from skincal.diagnosis.session_findings import findings_of
from skincal.diagnosis.shared_errors import covariance
from skincal.diagnosis.spells import find_spells
from skincal.diagnosis.where import shares, where_text
from skincal.effects import EFFECTS
from skincal.fitting.tasks import Mapper
from skincal.inference.columns import free_parameters
from skincal.inference.constants import CONSTANTS as C
from skincal.inference.contact_law import rejected_foundation
from skincal.inference.fit import Fitted, Fitter
from skincal.inference.search import search_effects
from skincal.inference.search_result import SearchResult
from skincal.inference.start import fit_base, outlier_presses, raw_residual, with_image_error, without_presses
from skincal.model.arrays import FloatArray

Heard = Callable[[str], None]


ORDER_FIRST = (
    "put the taxels in order, and import, fit and diagnose again; other presses tell nothing before",
)
"""What to do next where the taxels stand in another order than the data say."""

CORRUPTED_FIRST = (
    "read the taxel values as the finding says, and import, fit and diagnose again; other presses tell nothing before",
)
"""What to do next where the values are not what the sensor measured."""


def diagnose(
    dataset: Dataset,
    calibration: Calibration,
    seed: int = 0,
    heard: Heard = lambda _: None,
    null_sessions: int = C.null_sessions,
    more: int = MOST,
    mapper: Mapper = map,
) -> Diagnosis:
    """Finds what a calibrated simulation lacks against a dataset.

    Args:
        dataset: the session.
        calibration: of the same sensor; effects that it has already are kept.
        seed: of all chance.
        heard: told which stage begins.
        null_sessions: simulated sessions with nothing hidden.
        more: presses to make next at most, where effects have rivals.
        mapper: makes fits that do not need each other side by side; the result does not depend on it.

    Raises:
        InputError: the calibration is of another sensor.
        WorkError: too few presses.
    """
    check_same_sensor(calibration, dataset)
    split, searched, again, drawn, pressed, audited, spelled, dealt = np.random.default_rng(seed).spawn(8)
    heard("noise floor and places")
    checked = findings_of_check(dataset)
    corrupted, wait_for_order = is_corrupted(checked), search_for_order(dataset, mapper)
    observed = observe(dataset, calibration, split)
    fitter = observed.fitter
    if not corrupted and (stuck := find_spells(observed.session, fitter, fitter.priors.start, first=True)):
        observed = observed.without(stuck)
        fitter = observed.fitter
    base = fit_base(fitter, mapper, known=True)
    order = wait_for_order()
    wrong = corrupted or order is not None
    heard("what can be seen")
    audit = report_of(fitter, base.state, observed.floor, audited, calibrated=True, planned=False)
    heard("what is missing")
    # In wrong images no effect is looked for: what looks like one says nothing of the skin.
    names = () if wrong else observed.names
    found = search_effects(
        fitter, base, names, observed.covariates, searched,
        progress=heard, null_sessions=null_sessions, mapper=mapper,
    )  # fmt: skip
    if not wrong and (found.is_incomplete or found.is_doubtful):
        # About the best model: what an effect does to a taxel and its neighbours may look like a step about the base.
        spells = find_spells(observed.session, fitter, found.final.state)
        if spells:
            other = observed.without(spells)
            base = fit_base(other.fitter, mapper, known=True)
            anew = search_effects(
                other.fitter, base, other.names, other.covariates, spelled,
                progress=heard, null_sessions=null_sessions, mapper=mapper,
            )  # fmt: skip
            # What was taken off must have been what was left.
            if anew.excess.max() < found.excess.max():
                observed, fitter, found = other, other.fitter, anew
    heard("gap on presses nobody has fitted")
    gap = gap_of(observed, found.base.state, found.final.state, again)
    named = bool(found.selected)
    # What is left is more than chance, or presses that nobody has fitted are as far off or further: no name is sure.
    stays = gap.stays and not all(EFFECTS[n.name].in_places for n in found.selected)
    doubt = gap.refutes or stays or found.is_doubtful
    taken_back = tuple(n.name for n in found.selected) if named and doubt else ()
    unexplained = (not named and found.is_incomplete) or wrong
    verdict = "unknown" if taken_back or unexplained else "effects" if named else "none"
    unexplained = (found.is_incomplete or wrong) and verdict != "none"
    heard("calibration")
    final, effects = calibration, ()
    beaten = None if verdict == "unknown" else rejected_foundation(fitter, found.final, dealt)
    law = False
    if beaten is not None:
        # The presses of the end can take it back.
        by_law = gap_of(observed, beaten.state, found.final.state, again)
        law = by_law.after < by_law.before
        gap = by_law if law and verdict != "effects" and calibration.contact_law is None else gap
    if verdict == "none" and not law and _misfits(calibration, dataset):
        verdict, unexplained = "unknown", True
    if verdict == "effects" or law:
        whole = observed.whole()
        ready = placed_presses(whole, found.final.state, np.flatnonzero(observed.held))
        wild = outlier_presses(whole, ready)
        last_fitter = with_image_error(without_presses(whole, wild), ready)
        last = last_fitter.solve(ready, found.final.free, steps=C.joint_steps)
        wide = covariance(dataset, last_fitter, last)
        effects = _named(found, observed, last, wide) if verdict == "effects" else ()
        final = new_calibration(
            calibration, observed, last, wide, drawn, wild, unexplained=unexplained, law=law
        )
    left = _residual(fitter, found.base)
    depends = shares(left, observed.session)
    shown = found.final if effects else found.base
    findings = findings_of(observed, calibration, final, found.base, shown, effects, gap)
    if wrong:
        # What else stands out is that of the wrong images.
        findings = tuple(one for one in findings if one.severity == "info")
    findings = (*checked, *([] if order is None else [order]), *findings)
    findings = tuple(one.in_unit(dataset.meta.sensor.unit) for one in findings)
    heard("next presses")
    rivals = (
        [(n.name, found.final, other, fit) for n in found.selected for other, fit in n.rivals]
        if effects
        else []
    )
    if not wrong:
        words, plan = next_presses(
            observed, audit, depends, rivals, pressed, unknown=verdict == "unknown", most=more
        )
    else:
        words, plan = CORRUPTED_FIRST if corrupted else ORDER_FIRST, None
    return Diagnosis(
        verdict, effects, unexplained, where_text(left, observed.session, dataset.layout()), gap, observed.floor, audit,
        found, observed, depends[:6], findings, final, seed, words, plan, taken_back,
    )  # fmt: skip


def _misfits(calibration: Calibration, dataset: Dataset) -> bool:
    """Return whether the fit of these data says that its images lack something: then something is missing."""
    of = calibration.provenance.dataset_sha256
    return of == (dataset.sha256 or "") and any(one.code == "misfit" for one in calibration.findings)


def _residual(fitter: Fitter, fit: Fitted) -> FloatArray:
    return np.where(np.isfinite(fitter.counts), raw_residual(fitter, fit.state), np.nan)


def _named(
    found: SearchResult, observed: Observed, last: Fitted, wide: FloatArray
) -> tuple[NamedEffect, ...]:
    """Of what was found; numbers are those of the last fit, to all presses, as in the calibration."""
    fit, fitter = found.final, observed.fitter
    excess = [float(np.nansum(_residual(fitter, x) ** 2 - 1)) for x in (found.base, fit)]
    whole = max(excess[0] - excess[1], 1e-9)
    made = []
    for one in found.selected:
        without = {n: v for n, v in fit.state.effects.items() if n != one.name}
        residual = np.where(
            np.isfinite(fitter.counts), raw_residual(fitter, replace(fit.state, effects=without)), np.nan
        )
        alone = len(found.selected) == 1
        share = (
            1 - max(excess[1], 0.0) / max(excess[0], 1e-9)
            if alone
            else (float(np.nansum(residual**2 - 1)) - excess[1]) / whole
        )
        made.append(
            NamedEffect(
                one.name, one.equivalents, one.p_value, one.gain, dict(last.state.effects[one.name]),
                effect_intervals(last, one.name, wide),
                where_text(_residual(fitter, found.base) if alone else residual, observed.session,
                observed.dataset.layout()),
                float(np.clip(share, 0.0, 1.0)), EFFECTS[one.name].in_places,
            )
        )  # fmt: skip
    return tuple(made)


def refitted_effects(
    dataset: Dataset, calibration: Calibration, known: Calibration, seed: int = 0
) -> Calibration:
    """A calibration of the base model, with the effects of another one fitted beside it to the same session.

    An effect that the dataset cannot speak of, for it lacks a covariate, stays as it was.

    Args:
        dataset: the session that ``calibration`` was fitted to.
        calibration: of the base model.
        known: has the effects.
        seed: of all chance.

    Raises:
        InputError: ``known`` is of another sensor.
        WorkError: too few presses.
    """
    check_same_sensor(known, dataset)
    law = known.contact_law is not None
    both = replace(calibration, effects=known.effects, contact_law=known.contact_law)
    rng, drawn = np.random.default_rng(seed).spawn(2)
    observed = observe(dataset, both, rng, keep=False)
    base = fit_base(observed.fitter, known=True)
    free = []
    for name, values in base.state.effects.items():
        if name in observed.names:
            checked = EFFECTS[name].checked(values, dataset.layout().taxels)
            free += free_parameters(name, checked, None, observed.covariates)
    state = replace(
        base.state,
        effects={
            n: dict(EFFECTS[n].checked(v, dataset.layout().taxels)) for n, v in base.state.effects.items()
        },
    )
    fitter = observed.fitter
    last = fitter.solve(state, tuple(free), steps=C.last_steps)
    wild = outlier_presses(fitter, last.state)
    # They have drawn sensor, places and effects after them: again without them.
    fitter = with_image_error(without_presses(fitter, wild), last.state)
    last = fitter.solve(state if len(wild) else last.state, tuple(free), steps=C.last_steps)
    wide = covariance(dataset, fitter, last)
    made = new_calibration(both, observed, last, wide, drawn, wild, unexplained=False, law=law)
    return replace(made, provenance=calibration.provenance, grid=calibration.grid)
