"""Proportions with their intervals, and numbers with what is asked of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from benchmarks.blind.outcome import Outcome
from benchmarks.coverage_tables import wilson

Record = dict[str, Any]


def share(
    hits: Iterable[bool], *, at_least: float | None = None, at_most: float | None = None, also_wrong: int = 0
) -> Record:
    """A proportion, its interval, and whether it reaches a bound."""
    given = [bool(hit) for hit in hits]
    count, hit = len(given) + also_wrong, sum(given)
    if at_most is not None:
        hit += also_wrong
    found: Record = {"hits": hit, "of": count, "share": hit / count if count else None}
    found["interval_95"] = list(wilson(hit, count))
    bound = at_least if at_least is not None else at_most
    if bound is not None:
        found["asked"] = f"{'>=' if at_least is not None else '<='} {100 * bound:g} %"
        value = found["share"]
        found["reached"] = (
            None if value is None else (value >= bound if at_least is not None else value <= bound)
        )
    return found


def by(
    outcomes: Sequence[Outcome], key: Callable[[Outcome], Any], hit: Callable[[Outcome], bool] | None = None
) -> dict[str, Record]:
    """A share for every kind of session; of the right class, if not told otherwise."""
    hit = hit or Outcome.right_class
    kinds = sorted({str(key(o)) for o in outcomes})
    return {kind: share(hit(o) for o in outcomes if str(key(o)) == kind) for kind in kinds}


def mean(values: Iterable[float]) -> float | None:
    """None of no values."""
    given = list(values)
    return float(np.mean(given)) if given else None


def bounded(value: float | None, *, at_least: float | None = None, at_most: float | None = None) -> Record:
    """A number and whether it reaches a bound."""
    bound = at_least if at_least is not None else at_most
    assert bound is not None
    reached = None if value is None else (value >= bound if at_least is not None else value <= bound)
    asked = f"{'>=' if at_least is not None else '<='} {bound:g}"
    return {"value": value, "asked": asked, "reached": reached}
