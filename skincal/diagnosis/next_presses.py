"""The presses to make next: those with most expected information on what is still open."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from skincal.calibrate.data_findings import has_joints
from skincal.collect import Plan
from skincal.collect.protocols import named_by_order
from skincal.dataset import Dataset
from skincal.dataset.uniform_pressure import uniform_pressure
from skincal.diagnosis.audit import AuditReport
from skincal.diagnosis.ladder import WORDS, factors_of, ladder_plan
from skincal.diagnosis.observed import Observed, forward_of
from skincal.diagnosis.pool import imagined, pool_plan
from skincal.diagnosis.reasons import cures, facts_of, on_a_stage
from skincal.diagnosis.rig import Rig
from skincal.diagnosis.where import Share
from skincal.inference.fit import Fitted, Fitter, Priors
from skincal.model.arrays import FloatArray

PLAN_FILE = "next-presses.toml"
"""Name of the plan, beside the report."""
MOST = 12
_CAP_M, _LARGER_M, _APART, _MANY = 4e-3, 6e-3, 0.2, 3
_SINGLE = (
    "uniform pressure shows what each taxel does by itself: press single places with a small indenter, too"
)


def next_presses(
    observed: Observed,
    audit: AuditReport,
    depends: Sequence[Share],
    rivals: Sequence[tuple[str, Fitted, str, Fitted]],
    rng: np.random.Generator,
    *,
    unknown: bool,
    most: int = MOST,
) -> tuple[tuple[str, ...], Plan | None]:
    """In words, and as a plan where there is one.

    Args:
        observed: the session.
        audit: what it can show.
        depends: on what the residual depends.
        rivals: pairs of explanations that these data cannot tell apart, with their fits.
        rng: draws the presses to choose from.
        unknown: whether something is missing that nothing explains.
        most: presses that are chosen to tell rivals apart.
    """
    dataset = observed.dataset
    uniform = uniform_pressure(dataset)
    words = tuple(_unseen(observed, audit, None if uniform else _other_cap_m(dataset)))
    if uniform:
        return (_SINGLE, *words), None
    rig = Rig.of(dataset)
    if unknown:
        factors = factors_of([s.name for s in depends if s.times > 1.3], rig)
        plan = ladder_plan(factors, rig, rng)
        how = " and ".join(WORDS[f] for f in factors)
        said = (
            f"on what it depends: the {len(plan)} presses of {PLAN_FILE}, in which {how}, show "
            f"it; then look at them one by one"
        )
        return (said, *words), plan
    if not rivals:
        return words, None
    pool = pool_plan(rig, rng)
    told = np.zeros(len(pool))
    gains: list[FloatArray] = []
    for _, first, _, second in rivals:
        gains.append(information(observed, pool, rig, first, second, rng))
        told += gains[-1]
    picked = np.argsort(-told)[:most]
    lines = []
    for (a, _, b, _), own in zip(rivals, gains, strict=True):
        off = float(np.sqrt(own[picked].sum()))
        lines.append(
            f"to tell {a} from {b}: the presses of {PLAN_FILE}; on these the two lie "
            f"{off:.1f} standard deviations apart"
        )
    return (*lines, *words), plan_of(pool, picked.tolist(), rig)


def information(
    observed: Observed, pool: Plan, rig: Rig, first: Fitted, second: Fitted, rng: np.random.Generator
) -> FloatArray:
    """(presses of the pool,) squared distance of two explanations, each press's own numbers taken out."""
    session = imagined(pool, rig, observed.dataset, rng)
    like = observed.fitter.forward
    forward = forward_of(session, like.surface, like.layout, like.noise, clipped=like.rests_clipped)
    still = np.zeros((session.presses, 3))
    seen, other = (forward.predict(replace(f.state, move=still)) for f in (first, second))
    counts = np.zeros((len(session), seen.values.shape[1]))
    before = Priors(
        observed.fitter.priors.base, first.state, observed.fitter.priors.move, 2e-3, np.ones_like(counts)
    )
    fitter = Fitter(forward, counts, before)
    w = fitter.whitened(seen, (other.values - seen.values)[..., None], fitter.equation_errors(seen)[0])
    found = fitter.linearised(seen, (), w, 0).blocks
    out = np.zeros(len(pool))
    for k, p in enumerate(found.press.tolist()):
        if 0 <= p < len(out):
            out[p] = float(found.h[k, 0, 0])
    return out


def plan_of(pool: Plan, picked: Sequence[int], rig: Rig) -> Plan:
    """The picked presses in the order of the pool, between two anchors, so that they are a session of their own."""
    anchor = replace(rig.usual, kind="anchor")
    chosen = [p for i, p in enumerate(pool.presses) if i in set(picked)]
    first = [p for p in chosen if p.indenter_radius_m is None]
    named = named_by_order([anchor, *first, anchor, *(p for p in chosen if p.indenter_radius_m is not None)])
    ends = (0, len(first) + 1)
    return rig.plan(
        "next-presses", [replace(p, kind="anchor") if i in ends else p for i, p in enumerate(named)]
    )


def _other_cap_m(dataset: Dataset) -> float:
    """Radius of a second sphere for a hand whose own is that of a dataset [m]: clearly another one."""
    own = dataset.meta.indenter.radius_m
    return _CAP_M if own is None or not np.isfinite(own) or abs(own - _CAP_M) > _APART * own else _LARGER_M


def _unseen(observed: Observed, audit: AuditReport, other_cap_m: float | None) -> Iterator[str]:
    """What to record so that effects can be seen that these presses cannot show, those alike together."""
    facts = facts_of(observed.session)
    groups: dict[tuple[str, ...], list[str]] = {}
    for name in audit.cannot_see:
        groups.setdefault(cures(audit.effects[name], facts), []).append(name)
    by_hand = has_joints(observed.dataset)
    for cure, names in groups.items():
        said = cure if by_hand else tuple(map(on_a_stage, cure))
        yield f"to see {', '.join(names)}: {'; '.join(said)}"
    if by_hand and other_cap_m is not None and len(groups) >= _MANY:
        yield (
            f"skincal collect --protocol full --second-indenter-mm {1e3 * other_cap_m:g} does all of this in one "
            "session, but for tangential forces"
        )
