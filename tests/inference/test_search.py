"""The search's own order of things, with rounds that are made up."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pytest

from skincal.inference.constants import CONSTANTS as C
from skincal.inference.equation_errors import beyond, owed
from skincal.inference.search import Named, Search


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
    assert one.gain == 20.0 * 2 * C.most


class Entry(SimpleNamespace):
    """Of a round."""

    __hash__ = object.__hash__


class Settling(Search):
    """A joint fit that gains 40 nats after a few steps, and something else once it is settled."""

    settled = 0.0

    def _scaled(self, fit: Any, tried: Any) -> Any:
        return None if tried.name == "saturation" else {"share": np.ones(1)}

    def _joint(self, fit: Any, tried: Any) -> Any:
        return [SimpleNamespace(state=None, free=(), each=2.0) for _ in tried]

    def _ends(self, begin: Any) -> Any:
        return [SimpleNamespace(each=self.settled / 20) for _ in begin]

    def score(self, fit: Any) -> Any:
        return np.full(20, fit.each)


@pytest.mark.parametrize(("settled", "named"), [(16.0, False), (36.0, True)])
def test_named_effect_is_beyond_its_limit_once_settled(settled: float, named: bool):
    none: Any = None
    before: Any = SimpleNamespace(each=0.0)
    search = Settling(none, none, (), frozenset(), np.random.default_rng(0))
    search.settled = settled
    tried: Any = Entry(name="cover", gain=40.0, shared=26.0, sure=2.9, limit=30.0, p_value=0.01)
    assert bool(search._best(before, [tried])) is named


def test_equation_error_bars_only_what_is_like_it():
    """Four values of two taxels, two of them at one force and two at another."""
    does, cells = np.full((4, 2), 3.0), np.repeat([[0, 0], [1, 1]], 2, axis=0)
    bent = np.repeat([[2.0, 2.0], [-1.0, -1.0]], 2, axis=0)  # by the force
    error, curvature = C.alike * does * np.sign(bent), 30.0
    gained = 0.5 * float((bent * error).sum()) ** 2 / curvature
    assert owed([does], [cells], bent, curvature) == pytest.approx(gained)
    of_taxels = np.tile([1.0, -1.0], (4, 1))
    assert owed([does], [cells], of_taxels, curvature) == 0


def test_equation_error_has_one_factor_a_phase():
    rng, phases = np.random.default_rng(3), np.repeat(np.arange(3), 4)
    does = 100 * rng.standard_normal((12, 2))
    like = does * rng.standard_normal(3)[phases][:, None]
    other = rng.standard_normal((12, 2))
    for p in range(3):
        own = phases == p
        other[own] -= does[own] * (other[own] * does[own]).sum() / (does[own] ** 2).sum()
    assert np.abs(beyond([does], phases, like)).max() < 1e-3 * np.abs(like).max()
    assert beyond([does], phases, other) == pytest.approx(other)


class Lumpy(Settling):
    """A joint fit that gains 20 nats on some presses and loses a little on the others."""

    on = 0

    def _joint(self, fit: Any, tried: Any) -> Any:
        assert all(t.name != "saturation" for t, _ in tried)
        return self._ends(tried)

    def _ends(self, begin: Any) -> Any:
        each = np.where(np.arange(20) < self.on, 20.0, -0.4)
        return [SimpleNamespace(state=None, free=(), each=each) for _ in begin]


@pytest.mark.parametrize(("on", "named"), [(C.few, False), (C.few + 3, True)])
def test_what_few_presses_gain_is_no_evidence_whatever_it_is(on: int, named: bool):
    none: Any = None
    before: Any = SimpleNamespace(each=0.0)
    search = Lumpy(none, none, (), frozenset(), np.random.default_rng(0))
    search.on = on
    tried: Any = Entry(name="cover", gain=40.0, shared=6.0, sure=1.5, limit=30.0, p_value=0.01)
    assert bool(search._best(before, [tried])) is named
    # What bounds keep from what its slopes promise takes no place of others, however much that is.
    cannot = [Entry(**vars(tried) | {"name": "saturation", "gain": 900.0, "shared": 90.0})] * C.contenders
    assert bool(search._best(before, [*cannot, tried])) is named


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

    def _without(self, fit: Any, names: Any, *, few: bool = False) -> Any:
        left = [tuple(n for n in ("creep", "latency") if n in fit.effects and n != name) for name in names]
        return [SimpleNamespace(effects=effects) for effects in left]

    def _from_start(self, fit: Any) -> Any:
        return fit


def test_what_is_alike_alone_is_told_apart_by_what_else_there_is():
    base: Any = SimpleNamespace(blocks=SimpleNamespace(press=np.arange(20)), effects=())
    base.state = SimpleNamespace(effects={})
    none: Any = None
    found = Forking(none, base, (), frozenset(), np.random.default_rng(0)).run()
    assert [n.alike for n in found.named] == [("latency",), ("cover",)]
