"""The search's own order of things, with rounds that are made up."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from skincal.inference.constants import CONSTANTS as C
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
        return Named("dead_taxel", ("dead_taxel",), 20.0, 8.0, 0.01), fit

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
