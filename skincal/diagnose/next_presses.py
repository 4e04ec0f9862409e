"""The presses to make next: those that set rivals apart, or show what cannot be seen yet, or what nothing explains."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from skincal.collect import Plan
from skincal.collect.protocols import named_by_order
from skincal.dataset import Dataset
from skincal.dataset.uniform import uniform_pressure
from skincal.diagnose.diagnosis import Diagnosis
from skincal.diagnose.ladder import WORDS, factors_of, ladder_plan
from skincal.diagnose.pool import imagined, pool_plan
from skincal.diagnose.prepare import force_variance
from skincal.diagnose.rig import Rig
from skincal.diagnose.rivals import Pair, pairs_of
from skincal.diagnose.session import hold_groups
from skincal.gap.models import Model
from skincal.gap.noise import force_scatter
from skincal.gap.reading import Reading
from skincal.gap.reasons import cures, facts_of
from skincal.gap.separate import Contest, contest, pick
from skincal.inference.session import GapSession
from skincal.model.arrays import FloatArray

PLAN_FILE = "next-presses.toml"
"""Name of the plan, beside the report."""

PICKED = 24
_USEFUL = 1.15
"""Presses are worth making that raise the distance of two explanations by this factor."""

_MANY = 3
_CAP_M, _LARGER_M, _APART = 4e-3, 6e-3, 0.2
"""A second sphere of the hand, and the one where its own is about as large."""


@dataclass(frozen=True)
class Gain:
    """What a plan would do for two explanations; distances are in standard deviations.

    Attributes:
        pair: which they are.
        now: distance on the presses there are: root of the difference of what the two explain.
        added: with the plan added to them.
        alone: on the plan's presses alone.
        unlike: part of what the first does on the plan's presses that the second cannot imitate.
    """

    pair: Pair
    now: float
    added: float
    alone: float
    unlike: float


@dataclass(frozen=True)
class NextPresses:
    """What to press next.

    Attributes:
        words: in a sentence each.
        plan: the presses; None where words say all there is.
        gains: what the plan would do, of each pair of rivals.
    """

    words: tuple[str, ...] = ()
    plan: Plan | None = None
    gains: tuple[Gain, ...] = ()


_SINGLE = (
    "uniform pressure shows what each taxel does by itself: press single places with a small indenter, too"
)


def with_next_presses(found: Diagnosis, dataset: Dataset, rng: np.random.Generator) -> Diagnosis:
    """A diagnosis with the presses that would tell what is still open.

    Args:
        found: the diagnosis.
        dataset: that was diagnosed; says what its rig can do.
        rng: draws the presses to choose from.
    """
    told = next_presses(found, dataset, rng)
    return replace(found, next_presses=told.words, next_plan=told.plan)


def next_presses(found: Diagnosis, dataset: Dataset, rng: np.random.Generator) -> NextPresses:
    """What to press next; arguments as of :func:`with_next_presses`."""
    words = tuple(_unseen(found, None if uniform_pressure(dataset) else _other_cap_m(dataset)))
    if uniform_pressure(dataset):
        return NextPresses((_SINGLE, *words))
    if found.verdict == "unknown":
        return _shape(found, Rig.of(dataset), words, rng)
    pairs = pairs_of(found.choice) if found.verdict == "effects" else ()
    return NextPresses(words) if not pairs else _apart(found, pairs, dataset, words, rng)


def _apart(
    found: Diagnosis,
    pairs: Sequence[Pair],
    dataset: Dataset,
    words: tuple[str, ...],
    rng: np.random.Generator,
) -> NextPresses:
    rig = Rig.of(dataset)
    plan, gains = _chosen(found, pairs, pool_plan(rig, rng), rig, dataset, rng)
    if not _useful(gains) and rig.radii_m:
        # Only now: another indenter means that someone has to change it.
        plan, gains = _chosen(found, pairs, pool_plan(rig, rng, caps=True), rig, dataset, rng)
    if not _useful(gains):
        said = f"no further presses of the kinds that this rig made set {_names(gains)} apart"
        return NextPresses((said + "; other indenters, poses or forces may", *words), None, gains)
    return NextPresses((*(_gain_words(g, len(plan)) for g in gains), *words), plan, gains)


def _chosen(
    found: Diagnosis,
    pairs: Sequence[Pair],
    pool: Plan,
    rig: Rig,
    dataset: Dataset,
    rng: np.random.Generator,
) -> tuple[Plan, tuple[Gain, ...]]:
    """The presses of a pool that do most, and what they do in their own order and at their own times."""
    picked = pick(_contests(pairs, pool, rig, dataset, found, rng), PICKED)
    plan = plan_of(pool, picked.tolist(), rig)
    contests = _contests(pairs, plan, rig, dataset, found, rng)
    return plan, tuple(_gain(p, c) for p, c in zip(pairs, contests, strict=True))


def _useful(gains: Sequence[Gain]) -> bool:
    return any(g.added >= _USEFUL * max(g.now, 1.0) for g in gains)


def _contests(
    pairs: Sequence[Pair],
    plan: Plan,
    rig: Rig,
    dataset: Dataset,
    found: Diagnosis,
    rng: np.random.Generator,
) -> list[Contest]:
    session = imagined(plan, rig, dataset, rng)
    if found.session.taxels is not None:
        session = session.of_taxels(found.session.taxels)
    reading = expected_reading(session, found.choice.after, found.material.reading, dataset)
    options = found.material.options
    return [contest((p.first, p.second), p.models, p.apart, session, reading, options) for p in pairs]


def expected_reading(session: GapSession, true: Model, like: Reading, dataset: Dataset) -> Reading:
    """The noise that a planned session would have.

    Args:
        session: the planned one.
        true: what is taken to be true.
        like: of the dataset's own session.
        dataset: says how noisy its force is.
    """
    shape = (len(session), like.counts.shape[1])
    trust = np.broadcast_to(like.seen.any(axis=0).astype(np.float64), shape)
    nothing: FloatArray = np.zeros(shape)
    reading = replace(like, counts=nothing, frames=session.frames, trust=trust, further=nothing, lift=nothing)
    frames = dataset.frames
    noise_n = 0.0 if frames is None else force_scatter(frames.force_n, hold_groups(dataset))
    aimed = true.hypothesis.with_places(np.zeros((session.presses, 3)))
    return reading.with_further(force_variance(aimed, session, noise_n))


def plan_of(pool: Plan, picked: Sequence[int], rig: Rig) -> Plan:
    """The picked presses in the order of the pool, between two anchors, so that they are a session of their own."""
    anchor = replace(rig.usual, kind="anchor")
    chosen = [p for i, p in enumerate(pool.presses) if i in set(picked)]
    first = [p for p in chosen if p.indenter_radius_m is None]
    named = named_by_order([anchor, *first, anchor, *(p for p in chosen if p.indenter_radius_m is not None)])
    ends = (0, len(first) + 1)
    presses = [replace(p, kind="anchor") if i in ends else p for i, p in enumerate(named)]
    return rig.plan("next-presses", presses)


def _gain(pair: Pair, on_plan: Contest) -> Gain:
    further = on_plan.added() - on_plan.now
    return Gain(
        pair,
        float(np.sqrt(pair.apart)),
        float(np.sqrt(pair.apart + further)),
        float(np.sqrt(on_plan.alone())),
        on_plan.unlike(),
    )


def _gain_words(gain: Gain, presses: int) -> str:
    a, b = gain.pair.first, gain.pair.second
    why = f"to tell {a} from {b}" if gain.pair.alike else f"to be sure that it is {a} and not {b}"
    return (
        f"{why}: the {presses} presses of {PLAN_FILE}. If it is {a}, {b} lies {gain.now:.0f} standard "
        f"deviations off on the presses so far, {gain.added:.0f} with these added, {gain.alone:.0f} on these alone, "
        f"where it leaves {100 * gain.unlike:.0f} % of what {a} does (so far {100 * gain.pair.unlike:.0f} %)"
    )


def _names(gains: Sequence[Gain]) -> str:
    return " and ".join(dict.fromkeys(name for g in gains for name in (g.pair.first, g.pair.second)))


def _shape(found: Diagnosis, rig: Rig, words: tuple[str, ...], rng: np.random.Generator) -> NextPresses:
    """Where nothing known explains what is missing: presses that show on what it depends."""
    factors = factors_of(found.signatures, found.options.choice.significant, rig)
    plan = ladder_plan(factors, rig, rng)
    how = " and ".join(WORDS[f] for f in factors)
    significant = [s for s in found.signatures if s.p_value <= found.options.choice.significant]
    clear = [f"{s.meaning} ({100 * min(s.share, 1.0):.0f} %)" for s in significant[:2]]
    why = (
        f"the residual goes along with {' and '.join(clear)}" if clear else "on what it depends is not clear"
    )
    said = f"{why}: the {len(plan)} presses of {PLAN_FILE}, in which {how}, show how; then look at them one by one"
    return NextPresses((said, *words), plan)


def _other_cap_m(dataset: Dataset) -> float:
    """Radius of a second sphere for a hand whose own is that of a dataset [m]: clearly another one."""
    own = dataset.meta.indenter.radius_m
    return _CAP_M if own is None or not np.isfinite(own) or abs(own - _CAP_M) > _APART * own else _LARGER_M


def _unseen(found: Diagnosis, other_cap_m: float | None) -> Iterator[str]:
    """What to record so that effects can be seen that these presses cannot show, those alike together.

    Args:
        found: a diagnosis.
        other_cap_m: radius of a second sphere for the hand [m]; None: no hand presses, as in a pressure chamber.
    """
    facts = facts_of(found.session)
    groups: dict[tuple[str, ...], list[str]] = {}
    for name in found.audit.cannot_see:
        groups.setdefault(cures(found.audit.effects[name], facts), []).append(name)
    for cure, names in groups.items():
        yield f"to see {', '.join(names)}: {'; '.join(cure)}"
    if other_cap_m is not None and len(groups) >= _MANY:
        yield (
            f"skincal collect --protocol full --second-indenter-mm {1e3 * other_cap_m:g} does all of this in one "
            "session, but for tangential forces"
        )
