"""The search's own order of things, with rounds that are made up."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pytest

from skincal.inference.constants import CONSTANTS as C
from skincal.inference.search import Named, Search, owed


class Endless(Search):
    """One more taxel of the same effect gains in every round."""

    asked = 0

    def _drawn(self) -> Any:
        return None

    def _round(self, fit: Any, named: Any) -> Any:
        self.asked += 1
        assert self.asked < 50, "the search does not end"
        return [SimpleNamespace(good=True, name="dead_taxel")]

    def _best(self, fit: Any, good: Any) -> Any:
        return [(Named("dead_taxel", ("dead_taxel",), 20.0, 8.0, 0.01), fit)]

    def score(self, fit: Any) -> Any:
        return np.zeros(12)

    def _from_start(self, fit: Any) -> Any:
        return fit


def test_a_search_ends_where_one_effect_gains_taxel_by_taxel():
    base: Any = SimpleNamespace(
        blocks=SimpleNamespace(press=np.arange(12)), state=SimpleNamespace(effects={})
    )
    none: Any = None
    found = Endless(none, base, (), frozenset(), np.random.default_rng(0)).run()
    (one,) = found.named
    assert one.gain == 20.0 * C.rounds


class Settling(Search):
    """A joint fit that gains 40 nats after a few steps, and something else once it is settled."""

    settled = 0.0

    def with_one(self, fit: Any, tried: Any) -> Any:
        return SimpleNamespace(state=None, free=(), each=2.0)

    def _settled(self, state: Any, free: Any) -> Any:
        return SimpleNamespace(each=self.settled / 20)

    def score(self, fit: Any) -> Any:
        return np.full(20, fit.each)


@pytest.mark.parametrize(("settled", "named"), [(16.0, False), (36.0, True)])
def test_named_effect_is_beyond_its_limit_once_settled(settled: float, named: bool):
    none: Any = None
    before: Any = SimpleNamespace(each=0.0)
    search = Settling(none, none, (), frozenset(), np.random.default_rng(0))
    search.settled = settled
    tried: Any = SimpleNamespace(name="cover", gain=40.0, shared=26.0, sure=2.9, limit=30.0, p_value=0.01)
    assert bool(search._best(before, [tried])) is named


@pytest.mark.parametrize(("rows", "share"), [(slice(0, 6), 1.0), (slice(6, 12), 0.0)])
def test_equation_error_bars_only_what_is_like_it(rows: slice, share: float):
    """Twelve values of three presses; what is named acts on the first six, what is looked for on some of them."""
    cells = 2 * np.repeat(np.arange(3), 4) + np.tile([0, 1], 6)  # press and phase
    errors, new = np.zeros((12, 2)), np.zeros((12, 2))
    errors[:6], new[rows] = 0.5, 7.0
    assert owed([errors], cells, new) == pytest.approx(share * 0.5 * C.alike**2 * float((errors**2).sum()))


class Lumpy(Settling):
    """A joint fit that gains 20 nats on some presses and loses a little on the others."""

    on = 0

    def with_one(self, fit: Any, tried: Any) -> Any:
        return SimpleNamespace(state=None, free=(), each=np.where(np.arange(20) < self.on, 20.0, -0.4))

    def _settled(self, state: Any, free: Any) -> Any:
        return self.with_one(None, None)


@pytest.mark.parametrize(("on", "named"), [(C.few, False), (C.few + 3, True)])
def test_what_few_presses_gain_is_no_evidence_whatever_it_is(on: int, named: bool):
    none: Any = None
    before: Any = SimpleNamespace(each=0.0)
    search = Lumpy(none, none, (), frozenset(), np.random.default_rng(0))
    search.on = on
    tried: Any = SimpleNamespace(name="cover", gain=40.0, shared=6.0, sure=1.5, limit=30.0, p_value=0.01)
    assert bool(search._best(before, [tried])) is named


class Forking(Search):
    """Two effects gain as much alone; a third gains more beside the second."""

    gains: ClassVar = {
        (): 0.0,
        ("creep",): 40.0,
        ("latency",): 39.0,
        ("creep", "cover"): 60.0,
        ("latency", "cover"): 90.0,
    }

    def _drawn(self) -> Any:
        return None

    def score(self, fit: Any) -> Any:
        return np.full(20, self.gains[fit.effects] / 20)

    def _round(self, fit: Any, named: Any) -> Any:
        names = ("cover",) if named else ("creep", "latency")
        return [SimpleNamespace(good="cover" not in fit.effects, name=n, gain=0.0) for n in names]

    def _best(self, fit: Any, good: Any) -> Any:
        new = {t.name: SimpleNamespace(effects=(*fit.effects, t.name), free=()) for t in good}
        names = tuple(new)
        gain = {n: float((self.score(x) - self.score(fit)).sum()) for n, x in new.items()}
        return [(Named(n, (n, *(m for m in names if m != n)), gain[n], 8.0, 0.01), x) for n, x in new.items()]

    def _without(self, fit: Any, name: str) -> Any:
        return SimpleNamespace(
            effects=tuple(n for n in ("creep", "latency") if n in fit.effects and n != name)
        )

    def _from_start(self, fit: Any) -> Any:
        return fit


def test_what_is_alike_alone_is_told_apart_by_what_else_there_is():
    base: Any = SimpleNamespace(blocks=SimpleNamespace(press=np.arange(20)), effects=())
    base.state = SimpleNamespace(effects={})
    none: Any = None
    found = Forking(none, base, (), frozenset(), np.random.default_rng(0)).run()
    assert [n.alike for n in found.named] == [("latency",), ("cover",)]
