"""Choose the most informative next presses for the questions that a diagnosis leaves open."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from skincal.calibrate.data_findings import has_joints
from skincal.collect import FullProtocol, Plan, full_plan
from skincal.covariates import COLUMNS, NUMBERS
from skincal.dataset import Dataset
from skincal.dataset.uniform_pressure import uniform_pressure
from skincal.diagnosis.audit import AuditReport
from skincal.diagnosis.factor_plan import WORDS, choose_factors, plan_factors
from skincal.diagnosis.invisible_effects import phrase_for_stage, recommend_recordings, summarize_presses
from skincal.diagnosis.observed import Observed
from skincal.diagnosis.planned_session import Schedule, schedule_plan
from skincal.diagnosis.residual_location import ResidualShare
from skincal.diagnosis.rig import Rig
from skincal.inference.fit import Fitted, Fitter, Priors
from skincal.inference.session import GapSession
from skincal.model.arrays import FloatArray, as_floats

PLAN_FILE = "next-presses.toml"
"""File name of the plan, next to the report."""
MOST = 12
"""Largest number of presses that distinguish rivals."""
_CLEAR_TIMES = 1.3
"""A factor is varied if its part of the session holds this multiple of its proportion of the excess residual."""
_CAP_M, _LARGER_CAP_M, _RADIUS_RATIO = 4e-3, 6e-3, 0.2
"""Radii of a second indenter [m], and the relative difference of two radii that are clearly different."""
_MANY_CURES = 3
"""Number of different recommendations from which a full protocol is recommended instead."""
_SINGLE = (
    "uniform pressure shows the response of each taxel alone: press single sites with a small indenter, too"
)


def next_presses(
    observed: Observed,
    audit: AuditReport,
    depends: Sequence[ResidualShare],
    rivals: Sequence[tuple[str, Fitted, str, Fitted]],
    rng: np.random.Generator,
    *,
    unknown: bool,
    most: int = MOST,
) -> tuple[tuple[str, ...], Plan | None]:
    """Return recommendations in words, and a plan if presses can answer the open questions.

    Args:
        observed: the session.
        audit: audit of the session.
        depends: parts of the session with much of the residual, strongest first.
        rivals: pairs of explanations that these data cannot distinguish, each with its fit.
        rng: draws the candidate presses.
        unknown: whether something is missing that no known effect explains.
        most: largest number of presses that distinguish rivals.
    """
    dataset = observed.dataset
    is_uniform = uniform_pressure(dataset)
    words = tuple(_recommend_for_unseen(observed, audit, None if is_uniform else _second_cap_m(dataset)))
    if is_uniform:
        return (_SINGLE, *words), None
    rig = Rig.of(dataset)
    if unknown:
        factors = choose_factors([s.name for s in depends if s.times > _CLEAR_TIMES], rig)
        plan = plan_factors(factors, rig, rng)
        how = " and ".join(WORDS[f] for f in factors)
        text = (
            f"to see what the residual depends on: make the {len(plan)} presses of {PLAN_FILE}, in which {how}; "
            f"then compare them one by one"
        )
        return (text, *words), plan
    if not rivals:
        return words, None
    candidates = plan_candidates(rig, rng)
    distances = [
        squared_distances(observed, candidates, rig, first, second, rng) for _, first, _, second in rivals
    ]
    picked = np.argsort(-sum(distances, start=np.zeros(len(candidates))))[:most]
    lines = [
        f"to distinguish {a} from {b}: make the presses of {PLAN_FILE}; their predictions of these presses are "
        f"{np.sqrt(own[picked].sum()):.1f} standard deviations apart"
        for (a, _, b, _), own in zip(rivals, distances, strict=True)
    ]
    chosen = [candidates.presses[k] for k in np.sort(picked)]
    return (*lines, *words), rig.plan_session(chosen)


def squared_distances(
    observed: Observed, candidates: Plan, rig: Rig, first: Fitted, second: Fitted, rng: np.random.Generator
) -> FloatArray:
    """Return the squared distance (P,) of two fits in each candidate press, in standard deviations.

    The nuisance parameters of each press are integrated out.
    """
    session = simulate_session(candidates, rig, observed.dataset, rng)
    forward = observed.forward_of(session)
    unmoved = np.zeros((session.presses, 3))
    seen, other = (forward.predict(replace(f.state, move=unmoved)) for f in (first, second))
    counts = np.zeros((len(session), seen.values.shape[1]))
    prior = observed.fitter.priors
    fitter = Fitter(forward, counts, Priors(prior.base, first.state, prior.move, 2e-3, np.ones_like(counts)))
    whitened = fitter.whitened(seen, (other.values - seen.values)[..., None], fitter.equation_errors(seen)[0])
    blocks = fitter.linearised(seen, (), whitened, 0).blocks
    distances = np.zeros(len(candidates))
    for k, press in enumerate(blocks.press.tolist()):
        if 0 <= press < len(distances):
            distances[press] = float(blocks.h[k, 0, 0])
    return distances


def _second_cap_m(dataset: Dataset) -> float:
    """Return the radius of a second sphere [m] that clearly differs from that of the dataset's indenter."""
    own = dataset.meta.indenter.radius_m
    is_different = own is None or not np.isfinite(own) or abs(own - _CAP_M) > _RADIUS_RATIO * own
    return _CAP_M if is_different else _LARGER_CAP_M


def _recommend_for_unseen(
    observed: Observed, audit: AuditReport, second_cap_m: float | None
) -> Iterator[str]:
    """Yield what to record so that the invisible effects become visible, one line for each set of recommendations."""
    variety = summarize_presses(observed.session)
    groups: dict[tuple[str, ...], list[str]] = {}
    for name in audit.cannot_see:
        groups.setdefault(recommend_recordings(audit.effects[name], variety), []).append(name)
    by_hand = has_joints(observed.dataset)
    for cures, names in groups.items():
        words = cures if by_hand else tuple(map(phrase_for_stage, cures))
        yield f"to see {', '.join(names)}: {'; '.join(words)}"
    if by_hand and second_cap_m is not None and len(groups) >= _MANY_CURES:
        yield (
            f"skincal collect --protocol full --second-indenter-mm {1e3 * second_cap_m:g} does all of this in one "
            "session, except for tangential forces"
        )


_REGULAR, _REPEATS, _REVISITS, _OTHER = 44, 12, 14, 14
_REST_S = 1.0
"""Longest observed part of the rest after a press [s]."""


def plan_candidates(rig: Rig, rng: np.random.Generator) -> Plan:
    """Return the candidates: a full protocol within the limits of a rig, without a second indenter."""
    options = FullProtocol(
        regular=_REGULAR,
        repeats=_REPEATS,
        revisits=_REVISITS,
        forces_n=rig.forces_n,
        speeds_m_per_s=rig.speeds_m_per_s,
        holds_s=rig.holds_s,
        poses=rig.poses[:4],
        anchor_force_n=rig.usual.force_n,
        second_indenter=_OTHER,
    )
    plan = full_plan(rng, rig.pressed_area, options, None)
    return replace(plan, presses=tuple(rig.on_surface(plan.presses)))


def simulate_session(plan: Plan, rig: Rig, dataset: Dataset, rng: np.random.Generator) -> GapSession:
    """Return the observations that a plan would bring on the rig of a dataset.

    Covariates that a plan does not say are those of the dataset: tangential forces by their ratio to the normal force,
    drawn from its presses; the temperature by its mean.

    Args:
        plan: presses in their order.
        rig: limits and timing of the rig.
        dataset: gives indenters, tangential forces and temperature.
        rng: draws the tangential forces.
    """
    radii = sorted({p.indenter_radius_m for p in plan.presses if p.indenter_radius_m is not None})
    tools = (None, *radii)
    kinds = np.array([tools.index(p.indenter_radius_m) for p in plan.presses])
    poses = np.array([rig.poses.index(p.pose) for p in plan.presses])
    indenters = tuple(dataset.indenter(radius) for radius in tools)
    session = schedule_plan(
        plan, rig.mount, (indenters, kinds), poses, _schedule(plan, rig), rig.frame_rate_hz
    )
    return replace(session, samples=replace(session.samples, **_draw_covariates(session, dataset, rng)))


def _draw_covariates(
    session: GapSession, dataset: Dataset, rng: np.random.Generator
) -> dict[str, FloatArray]:
    """Return what a plan does not say of a session's samples (K, ...), by attribute, where the dataset has it."""
    presses, samples, found = dataset.presses, session.samples, dict[str, FloatArray]()
    for one in (covariate for covariate in NUMBERS if covariate.unplanned):
        parts = [part for name in one.columns if (part := presses.column(name)) is not None]
        if len(parts) < len(one.columns) or not all(np.isfinite(part).any() for part in parts):
            continue
        if COLUMNS[one.columns[0]].quantity != "force":
            found[one.attribute] = np.full(len(samples), float(np.nanmean(parts[0])))
            continue
        ratio = np.stack(parts, axis=1) / np.maximum(presses.force_n, 1e-3)[:, None]
        ratio = ratio[np.isfinite(ratio).all(axis=1)]
        if len(ratio):
            drawn = ratio[rng.integers(0, len(ratio), session.presses)][np.maximum(session.row, 0)]
            found[one.attribute] = drawn * np.where(samples.touching, samples.contacts.force_n, 0.0)[:, None]
    return found


def _schedule(plan: Plan, rig: Rig) -> Schedule:
    """Return the times of the presses of a plan at the pace of a rig."""
    ramp = [rig.ramp[0] + rig.ramp[1] * p.force_n / p.speed_m_per_s for p in plan.presses]
    phases_s = np.array([[0.0, r, p.hold_s, r] for r, p in zip(ramp, plan.presses, strict=True)])
    lengths_s = phases_s.sum(axis=1)
    start_s = rig.idle_s * np.arange(1, len(plan) + 1) + np.cumsum(lengths_s) - lengths_s
    times = as_floats(start_s[:, None] + np.cumsum(phases_s, axis=1))
    return Schedule(times, np.full(len(plan), min(rig.idle_s, _REST_S)))
