"""Run a diagnosis: fit the base model, search for effects, check them on the test presses, and calibrate."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from operator import call
from typing import Any

import numpy as np

from skincal.calibrate.data_findings import findings_of_check, is_corrupted, search_for_order
from skincal.calibration import Calibration
from skincal.calibration.matching import check_same_sensor
from skincal.dataset import Dataset
from skincal.diagnosis.audit import AuditReport, audit_session
from skincal.diagnosis.diagnosis import Diagnosis, NamedEffect, Verdict
from skincal.diagnosis.gap import Gap, measure_gap, place_presses
from skincal.diagnosis.next_presses import MOST, next_presses
from skincal.diagnosis.observed import Observed, observe
from skincal.diagnosis.residual_location import describe_residual, residual_shares
from skincal.diagnosis.session_findings import collect_findings
from skincal.diagnosis.shared_errors import posterior_covariance
from skincal.diagnosis.taxel_faults import find_faults
from skincal.diagnosis.updated_calibration import effect_intervals, update_calibration
from skincal.effects import EFFECTS
from skincal.fitting.tasks import Mapper
from skincal.inference.columns import free_parameters
from skincal.inference.constants import CONSTANTS as C
from skincal.inference.contact_law import rejected_foundation
from skincal.inference.fit import Fitted, Fitter
from skincal.inference.forward import State
from skincal.inference.search import search_effects
from skincal.inference.search_result import SearchResult
from skincal.inference.start import fit_base, outlier_presses, raw_residual, with_image_error, without_presses
from skincal.model.arrays import FloatArray, IntArray

Reporter = Callable[[str], None]
"""Progress callback; gets one line of text."""

_SHOWN_PARTS = 6
"""Number of parts of the session that a diagnosis reports."""
ORDER_FIRST = (
    "put the taxels in order, then import, fit and diagnose again; further presses do not help before that",
)
"""Next step if the taxels are stored in another order than the data say."""
CORRUPTED_FIRST = (
    "read the taxel values as the finding says, then import, fit and diagnose again; further presses do not help "
    "before that",
)
"""Next step if the stored values are not what the sensor measured."""


def diagnose(
    dataset: Dataset,
    calibration: Calibration,
    seed: int = 0,
    report_stage: Reporter = lambda _: None,
    null_sessions: int = C.null_sessions,
    max_presses: int = MOST,
    mapper: Mapper = map,
) -> Diagnosis:
    """Find what a calibrated simulation lacks compared with a dataset.

    Args:
        dataset: the session.
        calibration: calibration of the same sensor; its effects are kept.
        seed: seed of all randomness.
        report_stage: callback; gets the name of each stage as it begins.
        null_sessions: number of simulated sessions without effects.
        max_presses: largest number of next presses that distinguish rivals.
        mapper: runs independent fits in parallel; the result does not depend on it.

    Raises:
        InputError: the calibration is of another sensor.
        WorkError: too few presses.
    """
    check_same_sensor(calibration, dataset)
    rng_split, rng_search, rng_gap, rng_draws, rng_presses, rng_audit, rng_second, rng_law = (
        np.random.default_rng(seed).spawn(8)
    )
    report_stage("noise floor and contact positions")
    checked = findings_of_check(dataset)
    corrupted, wait_for_order = is_corrupted(checked), search_for_order(dataset, mapper)
    observed = observe(dataset, calibration, rng_split)
    if not corrupted:
        fitter = observed.fitter
        stuck = find_faults(observed.session, fitter, fitter.priors.start, state_is_calibrated=True)
        observed = observed.without(stuck) if stuck else observed
    base = fit_base(observed.fitter, mapper, start_is_calibrated=True)
    order = wait_for_order()
    images_are_wrong = corrupted or order is not None
    # In the background: the search does not need it.
    audit_task = partial(
        audit_session, observed.fitter, base.state, observed.floor, rng_audit,
        state_is_calibrated=True, planned=False,
    )  # fmt: skip
    audits = iter(mapper(call, [audit_task]))
    report_stage("missing effects")

    def search(session: Observed, base: Fitted, rng: np.random.Generator) -> SearchResult:
        # Images that are read wrongly say nothing about the skin, so no effect is searched for in them.
        names, covariates = () if images_are_wrong else session.names, session.covariates
        return search_effects(
            session.fitter, base, names, covariates, rng,
            progress=report_stage, null_sessions=null_sessions, mapper=mapper,
        )  # fmt: skip

    found = search(observed, base, rng_search)
    if not images_are_wrong and (found.is_incomplete or found.is_doubtful):
        # Relative to the best model: relative to the base model, an effect can look like a step of single taxels.
        faults = find_faults(observed.session, observed.fitter, found.final.state)
        if faults:
            repaired = observed.without(faults)
            second = search(repaired, fit_base(repaired.fitter, mapper, start_is_calibrated=True), rng_second)
            # Keep the removal only if it reduces the remaining excess.
            if second.excess.max() < found.excess.max():
                observed, found = repaired, second
    report_stage("gap on the test presses")
    # Side by side; in a single process each runs only when it is needed.
    last_checks: Sequence[Callable[[], Any]] = (
        partial(measure_gap, observed, found.base.state, found.final.state, rng_gap),
        partial(_confirm_contact_law, observed, found.final, rng_law),
        partial(_fit_all_presses, observed, found.final),
    )
    checks = iter(mapper(call, last_checks))
    gap: Gap = next(checks)
    verdict, taken_back = _judge(found, gap, images_are_wrong=images_are_wrong)
    unexplained = (found.is_incomplete or images_are_wrong) and verdict != "none"
    report_stage("calibration")
    law_gap: Gap | None = None if verdict == "unknown" else next(checks)
    has_law = law_gap is not None
    if law_gap is not None and verdict == "none" and calibration.contact_law is None:
        gap = law_gap
    if verdict == "none" and not has_law and _has_misfit(calibration, dataset):
        verdict, unexplained = "unknown", True
    final, effects = calibration, ()
    if verdict == "effects" or has_law:
        last, covariance, outliers = next(checks)
        effects = _describe_effects(found, observed, last, covariance) if verdict == "effects" else ()
        final = update_calibration(
            calibration, observed, last, covariance, rng_draws, outliers, unexplained=unexplained, law=has_law
        )
    residual = _residual(observed.fitter, found.base.state)
    depends = residual_shares(residual, observed.session)
    shown = found.final if effects else found.base
    findings = collect_findings(observed, calibration, final, found.base, shown, effects, gap)
    if images_are_wrong:
        # Warnings about wrong images follow from the wrong images alone.
        findings = tuple(finding for finding in findings if finding.severity == "info")
    findings = (*checked, *([] if order is None else [order]), *findings)
    report_stage("next presses")
    audit: AuditReport = next(audits)
    words, plan = CORRUPTED_FIRST if corrupted else ORDER_FIRST, None
    if not images_are_wrong:
        rivals = [(n.name, found.final, other, fit) for n in found.selected for other, fit in n.rivals]
        words, plan = next_presses(
            observed, audit, depends, rivals if effects else [], rng_presses,
            unknown=verdict == "unknown", most=max_presses,
        )  # fmt: skip
    return Diagnosis(
        verdict=verdict,
        effects=effects,
        unexplained=unexplained,
        where=describe_residual(residual, observed.session, dataset.meta.sensor.taxel_columns()),
        gap=gap,
        floor=observed.floor,
        audit=audit,
        found=found,
        observed=observed,
        depends=depends[:_SHOWN_PARTS],
        findings=tuple(finding.in_unit(dataset.meta.sensor.unit) for finding in findings),
        calibration=final,
        seed=seed,
        next_presses=words,
        next_plan=plan,
        taken_back=taken_back,
    )


def _judge(found: SearchResult, gap: Gap, *, images_are_wrong: bool) -> tuple[Verdict, tuple[str, ...]]:
    """Return the verdict of a search, and the names of effects that are taken back.

    Effects are taken back if the test presses refute them, if too much of the gap remains, or if the search itself
    left too much. Effects on contact positions alone hardly change the images, so the gap cannot contradict them.
    """
    only_positions = all(EFFECTS[n.name].in_places for n in found.selected)
    is_doubtful = gap.is_refuted or (gap.is_unexplained and not only_positions) or found.is_doubtful
    if found.selected and is_doubtful:
        return "unknown", tuple(n.name for n in found.selected)
    if images_are_wrong or (found.is_incomplete and not found.selected):
        return "unknown", ()
    return "effects" if found.selected else "none", ()


def _confirm_contact_law(observed: Observed, final: Fitted, rng: np.random.Generator) -> Gap | None:
    """Return the gap before and after the fitted contact law; None if the presses show no law.

    Held-out presses must prefer the law to the elastic foundation, and the error on the test presses must fall.
    """
    foundation = rejected_foundation(observed.fitter, final, rng)
    if foundation is None:
        return None
    gap = measure_gap(observed, foundation.state, final.state, rng)
    return gap if gap.after < gap.before else None


def _has_misfit(calibration: Calibration, dataset: Dataset) -> bool:
    """Return whether the calibration was fitted to this dataset with a ``misfit`` finding, so something is missing."""
    sha = calibration.provenance.dataset_sha256
    return sha == (dataset.sha256 or "") and any(finding.code == "misfit" for finding in calibration.findings)


def _residual(fitter: Fitter, state: State) -> FloatArray:
    """Return the residuals (N, J) over the noise, NaN where nothing was read."""
    return np.where(np.isfinite(fitter.counts), raw_residual(fitter, state), np.nan)


def _excess(residual: FloatArray) -> float:
    """Return chi-square minus number of values."""
    return float(np.nansum(residual**2 - 1))


def _fit_all_presses(observed: Observed, final: Fitted) -> tuple[Fitted, FloatArray, IntArray]:
    """Fit base model and effects to all presses, outliers left out; return fit, covariance and rows of the outliers."""
    fitter, state = observed.fitter_of_all(), final.state
    state = place_presses(fitter, state, np.flatnonzero(observed.is_test))
    outliers = outlier_presses(fitter, state)
    fitter = with_image_error(without_presses(fitter, outliers), state)
    fit = fitter.solve(state, final.free, steps=C.joint_steps)
    return fit, posterior_covariance(observed.dataset, fitter, fit), outliers


def _describe_effects(
    found: SearchResult, observed: Observed, last: Fitted, covariance: FloatArray
) -> tuple[NamedEffect, ...]:
    """Return the named effects; parameters and intervals are those of the last fit, to all presses."""
    fitter, state = observed.fitter, found.final.state
    taxel_names = observed.dataset.meta.sensor.taxel_columns()
    base_residual = _residual(fitter, found.base.state)
    before, after = _excess(base_residual), _excess(_residual(fitter, state))
    effects: list[NamedEffect] = []
    for named in found.selected:
        if len(found.selected) == 1:
            residual, share = base_residual, 1 - max(after, 0.0) / max(before, 1e-9)
        else:
            others = {n: v for n, v in state.effects.items() if n != named.name}
            residual = _residual(fitter, replace(state, effects=others))
            share = (_excess(residual) - after) / max(before - after, 1e-9)
        effects.append(
            NamedEffect(
                named.name,
                named.equivalents,
                named.p_value,
                named.gain,
                dict(last.state.effects[named.name]),
                effect_intervals(last, named.name, covariance),
                describe_residual(residual, observed.session, taxel_names),
                float(np.clip(share, 0.0, 1.0)),
                EFFECTS[named.name].in_places,
            )
        )
    return tuple(effects)


def refitted_effects(
    dataset: Dataset, calibration: Calibration, known: Calibration, seed: int = 0
) -> Calibration:
    """Return a calibration with the effects of another one, refitted to the same session.

    An effect stays as it was if the dataset lacks one of its covariates.

    Args:
        dataset: the session that ``calibration`` was fitted to.
        calibration: calibration of the base model.
        known: calibration with the effects.
        seed: seed of all randomness.

    Raises:
        InputError: ``known`` is of another sensor.
        WorkError: too few presses.
    """
    check_same_sensor(known, dataset)
    law = known.contact_law is not None
    both = replace(calibration, effects=known.effects, contact_law=known.contact_law)
    rng, rng_draws = np.random.default_rng(seed).spawn(2)
    observed = observe(dataset, both, rng, keep=False)
    fitter = observed.fitter
    state = fit_base(fitter, start_is_calibrated=True).state
    taxels = dataset.layout().taxels
    effects = {n: EFFECTS[n].checked(v, taxels) for n, v in state.effects.items()}
    free = [
        f
        for name, values in effects.items()
        if name in observed.names
        for f in free_parameters(name, values, None, observed.covariates)
    ]
    state = replace(state, effects={n: dict(v) for n, v in effects.items()})
    last = fitter.solve(state, tuple(free), steps=C.last_steps)
    outliers = outlier_presses(fitter, last.state)
    # The outliers have biased sensor, positions and effects: fit again without them.
    fitter = with_image_error(without_presses(fitter, outliers), last.state)
    last = fitter.solve(state if len(outliers) else last.state, tuple(free), steps=C.last_steps)
    covariance = posterior_covariance(dataset, fitter, last)
    refitted = update_calibration(
        both, observed, last, covariance, rng_draws, outliers, unexplained=False, law=law
    )
    return replace(refitted, provenance=calibration.provenance, grid=calibration.grid)
