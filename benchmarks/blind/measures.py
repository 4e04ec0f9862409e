"""Scores over the outcomes of the blind test.

A *share* is a proportion with its Wilson interval of 95 %, and whether it reaches what is asked of it. Every session
of a suite counts, those whose diagnosis failed as well: those count as wrong.

* *false alarm*: a verdict other than ``none`` where nothing is hidden.
* *scores*: where nothing is hidden, the best effect's p-value is 0.01 or less; it is named only if it explains enough,
  too.
* *right class*: the effect that is named first is of the class of the hidden one
  (:data:`benchmarks.blind.suites.CLASSES`).
* *exact name*: the effect that is named first is the hidden one; among sessions in which an effect is named, the
  hidden one is not in ``cannot_see`` and the reported set has a single name: there the diagnosis says that it can tell.
* *truth in set*: the hidden effect is in a reported set; among sessions in which an effect is named.
* *spurious third*: of two hidden effects, more than two were named.
* *abstains or names the class*: verdict ``none`` or ``unknown``, or every named effect's set holds a hidden effect.
* *gap closed*: what the diagnosis told of it, where the hidden effect is in the reported set; where it lives in the
  positions, the shrink of the slack; by strength and contact law only where it lives in the images.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from benchmarks.blind.outcome import Outcome
from benchmarks.blind.shares import bounded, by, mean, share
from benchmarks.blind.suites import CLASS_OF, CLASSES

Record = dict[str, Any]

STRONG_G, WEAK_G = 0.4, 0.2
ASKED_STRONG, ASKED_WEAK = 0.95, 0.85
"""Share of the right class that is asked from each strength on."""
BINS = (0.0, 0.19, 0.29, 0.39, 0.59, 0.89, 1.29, math.inf)
"""Edges of the power curve; strengths are hit to 2 %, so an edge lies a little below those that are asked for."""
_EDGE = 0.97
OF_PLACES = "contact_offset"
"""The effect that lives in the positions."""
SIGNIFICANT = 0.01
"""A score's p-value, as the diagnosis has it, from which on there is something."""


def summary(outcomes: Sequence[Outcome], failed: Sequence[Record]) -> Record:
    """All suites.

    Args:
        outcomes: of the sessions whose diagnosis ended well.
        failed: labels of the others.
    """
    found: Record = {}
    for suite, measure in _SUITES.items():
        some = [o for o in outcomes if o.label["suite"] == suite]
        wrong = [label for label in failed if label["suite"] == suite]
        if some or wrong:
            found[suite] = {"sessions": len(some) + len(wrong), "failed": len(wrong), **measure(some, wrong)}
    if times := [o.wall_s for o in outcomes]:
        cpu = [o.cpu_s for o in outcomes]
        found["seconds"] = {
            "wall_median": float(np.median(times)),
            "wall_largest": max(times),
            "cpu_median": float(np.median(cpu)),
        }
    return found


def _quiet(outcomes: Sequence[Outcome], failed: Sequence[Record]) -> Record:
    names = share(bool(o.named) for o in outcomes)
    alarms = share((o.verdict != "none" for o in outcomes), at_most=0.02, also_wrong=len(failed))
    kinds = sorted({str(o.label["decoy"]) for o in outcomes if o.label["decoy"]})
    by_kind = {
        kind: share(o.verdict != "none" for o in outcomes if o.label["decoy"] == kind) for kind in kinds
    }
    named = Counter(name for o in outcomes for name in (o.names or ([o.verdict] * (o.verdict != "none"))))
    scores = share(o.best_p <= SIGNIFICANT for o in outcomes)
    found: Record = {
        "false_alarms": alarms,
        "wrong_names": names,
        "scores": scores,
        "named": dict(named.most_common()),
    }
    return found | ({"by_kind": by_kind} if by_kind else {})


def _one(outcomes: Sequence[Outcome], failed: Sequence[Record]) -> Record:
    # An effect may have left no trace in its session (a taxel that dies after its last press).
    outcomes = [o for o in outcomes if o.hidden]
    strong = [o for o in outcomes if o.g >= _EDGE * STRONG_G]
    weak = [o for o in outcomes if _EDGE * WEAK_G <= o.g < _EDGE * STRONG_G]
    lost = [_strength(label) for label in failed]
    lost_strong = sum(g >= _EDGE * STRONG_G for g in lost)
    lost_weak = sum(_EDGE * WEAK_G <= g < _EDGE * STRONG_G for g in lost)
    naming = [o for o in outcomes if o.named]
    right = [o for o in naming if o.found(o.hidden[0])]
    # How much of the slack is noise of the positions, which nothing closes, is not known.
    in_images = [o for o in right if o.hidden != [OF_PLACES]]
    can_tell = [o for o in naming if o.hidden[0] not in o.cannot_see and len(o.named[0].consistent_with) == 1]
    return {
        "right_class_strong": share(
            (o.right_class() for o in strong), at_least=ASKED_STRONG, also_wrong=lost_strong
        ),
        "right_class_weak": share((o.right_class() for o in weak), at_least=ASKED_WEAK, also_wrong=lost_weak),
        "exact_name_where_it_can_be_told": share(
            (o.names[0] == o.hidden[0] for o in can_tell), at_least=0.85
        ),
        "exact_name_of_all": share((o.names[:1] == o.hidden for o in outcomes), also_wrong=len(failed)),
        "truth_in_set_where_named": share((o.found(o.hidden[0]) for o in naming), at_least=0.95),
        "truth_in_set_of_all": share((o.found(o.hidden[0]) for o in outcomes), also_wrong=len(failed)),
        "set_size": bounded(mean(o.set_size for o in naming), at_most=1.8),
        "verdicts": dict(Counter(o.verdict for o in outcomes)),
        "more_than_one_named": share(len(o.named) > 1 for o in outcomes),
        "cannot_see_though_hidden": share(o.hidden[0] in o.cannot_see for o in outcomes),
        "gap_closed": gap_closed(right),
        "gap_closed_strong": gap_closed([o for o in in_images if o.g >= _EDGE * STRONG_G]),
        "gap_by_strength": gap_by_strength(in_images),
        "power": power(outcomes),
        "by_effect": _by_effect(outcomes),
        "by_law": by(outcomes, lambda o: o.label["contact_law"]),
        "confusion": confusion(outcomes),
    }


def _two(outcomes: Sequence[Outcome], failed: Sequence[Record]) -> Record:
    found = [sum(o.found(name) for name in o.hidden) for o in outcomes]
    return {
        "both": share((n == 2 for n in found), at_least=0.8, also_wrong=len(failed)),
        "at_least_one": share((n >= 1 for n in found), at_least=0.95, also_wrong=len(failed)),
        "spurious_third": share((len(o.named) > 2 for o in outcomes), at_most=0.05, also_wrong=len(failed)),
        "any_wrong_name": share(bool(o.wrong()) for o in outcomes),
        "verdicts": dict(Counter(o.verdict for o in outcomes)),
        "both_by_weaker_g": {
            f"{low:g} to {high:g}": share(
                n == 2 for n, o in zip(found, outcomes, strict=True) if low <= o.g < high
            )
            for low, high in ((0.0, 0.39), (0.39, 0.59), (0.59, math.inf))
        },
        "gap_closed": gap_closed([o for n, o in zip(found, outcomes, strict=True) if n == 2]),
    }


def _outside(outcomes: Sequence[Outcome], failed: Sequence[Record]) -> Record:
    return {
        "unknown": share((o.verdict == "unknown" for o in outcomes), at_least=0.88, also_wrong=len(failed)),
        "confidently_wrong": share(
            (o.verdict == "effects" and not o.unexplained for o in outcomes),
            at_most=0.02,
            also_wrong=len(failed),
        ),
        "named_but_unexplained": share(o.verdict == "effects" and o.unexplained for o in outcomes),
        "missed": share(o.verdict == "none" for o in outcomes),
        "by_kind": by(outcomes, lambda o: o.label["outside"], lambda o: o.verdict == "unknown"),
        "named": dict(Counter(name for o in outcomes for name in o.names).most_common()),
    }


def _poor(outcomes: Sequence[Outcome], failed: Sequence[Record]) -> Record:
    def fine(o: Outcome) -> bool:
        return o.verdict != "effects" or not o.wrong()

    return {
        "abstains_or_names_the_class": share(map(fine, outcomes), at_least=0.95, also_wrong=len(failed)),
        "found": share(o.found(o.hidden[0]) for o in outcomes if o.hidden),
        "false_alarms": share(o.verdict != "none" for o in outcomes if not o.hidden),
        "by_protocol": by(outcomes, lambda o: o.label["protocol"], fine),
        "wrong": dict(Counter(e.name for o in outcomes for e in o.wrong()).most_common()),
    }


def _robust(outcomes: Sequence[Outcome], failed: Sequence[Record]) -> Record:
    def fine(o: Outcome) -> bool:
        allowed = set(o.label["also_fine"])
        if o.hidden:
            return all(o.found(name) for name in o.hidden) and not o.wrong()
        if o.verdict != "effects":
            return o.verdict in {"none", *allowed}
        return all(effect.consistent_with & allowed for effect in o.named)

    by_kind = by(outcomes, lambda o: o.label["decoy"], fine)
    return {"as_expected": share(map(fine, outcomes), also_wrong=len(failed)), "by_kind": by_kind}


def _mixed(outcomes: Sequence[Outcome], failed: Sequence[Record]) -> Record:
    """Sessions with nothing hidden and with one effect, in one suite."""
    empty = [o for o in outcomes if not o.hidden]
    strong = [o for o in outcomes if o.hidden and o.g >= _EDGE * STRONG_G]
    weak = [o for o in outcomes if o.hidden and _EDGE * WEAK_G <= o.g < _EDGE * STRONG_G]
    return {
        "wrong_names": share((bool(o.named) for o in empty), at_most=0.02),
        "unknown_though_empty": share(o.verdict == "unknown" for o in empty),
        "right_class_strong": share(
            (o.right_class() for o in strong), at_least=ASKED_STRONG, also_wrong=len(failed)
        ),
        "right_class_weak": share((o.right_class() for o in weak), at_least=ASKED_WEAK),
        "named": dict(Counter(name for o in empty for name in o.names).most_common()),
    }


_SUITES: dict[str, Callable[[Sequence[Outcome], Sequence[Record]], Record]] = {
    "none": _quiet,
    "decoy": _quiet,
    "one": _one,
    "two": _two,
    "outside": _outside,
    "poor": _poor,
    "robust": _robust,
    "rest": _mixed,
    "third": _mixed,
}


def power(outcomes: Sequence[Outcome]) -> list[Record]:
    """Rates of detection, right class and right name, by strength."""
    found: list[Record] = []
    for ends, some in _binned(outcomes):
        found.append(
            {
                "g": ends,
                "mean_g": mean(o.g for o in some),
                "detected": share(o.verdict != "none" for o in some),
                "right_class": share(o.right_class() for o in some),
                "truth_in_set": share(o.found(o.hidden[0]) for o in some if o.hidden),
                "exact_name": share(o.names[:1] == o.hidden for o in some),
            }
        )
    return found


def confusion(outcomes: Sequence[Outcome]) -> dict[str, dict[str, int]]:
    """Count the effects named first for each hidden effect; ``none`` and ``unknown`` are verdicts."""
    rows: dict[str, Counter[str]] = {}
    for o in outcomes:
        if o.hidden:
            rows.setdefault(o.hidden[0], Counter())[o.names[0] if o.named else o.verdict] += 1
    return {
        name: dict(rows[name].most_common()) for names in CLASSES.values() for name in names if name in rows
    }


def gap_closed(outcomes: Sequence[Outcome]) -> Record:
    """Median and 10th percentile of the part of the gap that is closed."""
    parts = [part for part in map(_closed, outcomes) if part is not None]
    if not parts:
        return {"of": 0}
    low, middle = np.quantile(parts, [0.1, 0.5])
    return {
        "of": len(parts),
        "median": bounded(float(middle), at_least=0.92),
        "percentile_10": bounded(float(low), at_least=0.75),
    }


def gap_by_strength(outcomes: Sequence[Outcome]) -> list[Record]:
    """:func:`gap_closed` by strength, of all contact laws and of each."""
    found: list[Record] = []
    for ends, some in _binned(outcomes):
        laws = sorted({str(o.label["contact_law"]) for o in some})
        by_law = {law: gap_closed([o for o in some if o.label["contact_law"] == law]) for law in laws}
        found.append({"g": ends, "all": gap_closed(some), "by_law": by_law})
    return found


def _binned(outcomes: Sequence[Outcome]) -> Iterator[tuple[list[float | None], list[Outcome]]]:
    """Bins of strength with a session in them: their ends, the last without an upper one, and the sessions."""
    for low, high in pairwise(BINS):
        if some := [o for o in outcomes if low <= o.g < high]:
            yield [low, high if math.isfinite(high) else None], some


def _closed(outcome: Outcome) -> float | None:
    gap = outcome.gap
    if outcome.hidden == [OF_PLACES] and gap.get("slack_rms_before_m"):
        # What the noise of the positions leaves of the slack is not told: the plain shrink.
        return 1 - (gap["slack_rms_after_m"] / gap["slack_rms_before_m"]) ** 2
    return gap.get("closed")


def _by_effect(outcomes: Sequence[Outcome]) -> dict[str, Record]:
    found: dict[str, Record] = {}
    for name in CLASS_OF:
        some = [o for o in outcomes if o.hidden == [name]]
        if some:
            strong = [o for o in some if o.g >= _EDGE * STRONG_G]
            found[name] = {
                "sessions": len(some),
                "right_class": share(o.right_class() for o in some),
                "right_class_strong": share(o.right_class() for o in strong),
                "exact_name": share(o.names[0] == name if o.named else False for o in some),
                "truth_in_set": share(o.found(name) for o in some),
                "set_size": mean(o.set_size for o in some if o.named),
                "gap_closed": gap_closed([o for o in some if o.found(name)]),
            }
    return found


def _strength(label: Record) -> float:
    return min((effect["strength_g"] for effect in label["effects"]), default=0.0)
