"""The search's own order of things, with made-up scores and fits."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pytest

from skincal.inference.candidate_fits import CandidateFits
from skincal.inference.constants import CONSTANTS as C
from skincal.inference.equation_errors import explainable_gain, without_errors
from skincal.inference.score import Score
from skincal.inference.search import Search
from skincal.inference.search_result import SelectedEffect


def selected(name: str, gain: float, *others: str) -> SelectedEffect:
    return SelectedEffect(name, (name, *others), gain, 8.0, 0.01)


class Endless:
    """Scores and fits in which one more taxel of the same effect gains in every round."""

    null = None
    asked = 0

    def score_candidates(self, fit: Any) -> Any:
        self.asked += 1
        assert self.asked < 50, "the search does not end"
        return [SimpleNamespace(passes_null=True, name="dead_taxel")]

    def shortlist(self, fit: Any, scores: Any) -> Any:
        return [(selected("dead_taxel", 20.0), fit)]

    def score(self, fit: Any) -> Any:
        return np.zeros(12)

    def without(self, fit: Any, names: Any, *, few_steps: bool = False) -> Any:
        assert not names
        return []

    def restarted(self, fit: Any) -> Any:
        return fit


def search(parts: Any, base: Any) -> Any:
    return Search(base, parts, parts).run()


def test_search_ends_taxel_by_taxel():
    (one,) = search(Endless(), SimpleNamespace()).selected
    assert one.gain == 20.0 * 2 * C.most


class Entry(SimpleNamespace):
    """Score of a candidate."""

    __hash__ = object.__hash__  # type: ignore[assignment]


class Settling(CandidateFits):
    """A joint fit that gains 40 nats after a few steps, and something else once it has converged."""

    each: Any = 0.0

    def start_values(self, fit: Any, scored: Any) -> Any:
        return None if scored.name == "saturation" else {"share": np.ones(1)}

    def fit_jointly(self, fit: Any, tried: Any) -> Any:
        return [SimpleNamespace(state=None, free=(), each=2.0) for _ in tried]

    def fit_to_end(self, begin: Any) -> Any:
        return [SimpleNamespace(state=None, free=(), each=self.each) for _ in begin]

    def score(self, fit: Any) -> Any:
        return np.full(20, fit.each)


def fits_of(kind: Any, each: Any) -> Any:
    none: Any = None
    fits = kind(none, none, none, frozenset())
    fits.each = each
    return fits


BEFORE: Any = SimpleNamespace(each=0.0)


@pytest.mark.parametrize(("total", "named"), [(16.0, False), (36.0, True)])
def test_named_effect_exceeds_its_limit_once_converged(total: float, named: bool):
    scored = Entry(name="cover", gain=40.0, clipped_gain=26.0, significance=2.9, limit=30.0, p_value=0.01)
    assert bool(fits_of(Settling, total / 20).shortlist(BEFORE, [scored])) is named


def test_equation_error_bars_only_its_like():
    """Four values of two taxels, two of them at one force and two at another."""
    does, cells = np.full((4, 2), 3.0), np.repeat([[0, 0], [1, 1]], 2, axis=0)
    bent = np.repeat([[2.0, 2.0], [-1.0, -1.0]], 2, axis=0)  # by the force
    error, curvature = C.alike * does * np.sign(bent), 30.0
    gained = 0.5 * float((bent * error).sum()) ** 2 / curvature
    assert explainable_gain([does], [cells], bent, curvature) == pytest.approx(gained)
    of_taxels = np.tile([1.0, -1.0], (4, 1))
    assert explainable_gain([does], [cells], of_taxels, curvature) == 0


def test_equation_error_has_one_factor_a_phase():
    rng, phases = np.random.default_rng(3), np.repeat(np.arange(3), 4)
    does = 100 * rng.standard_normal((12, 2))
    like = does * rng.standard_normal(3)[phases][:, None]
    other = rng.standard_normal((12, 2))
    for p in range(3):
        own = phases == p
        other[own] -= does[own] * (other[own] * does[own]).sum() / (does[own] ** 2).sum()
    assert np.abs(without_errors([does], phases, like)).max() < 1e-3 * np.abs(like).max()
    assert without_errors([does], phases, other) == pytest.approx(other)


class Lumpy(Settling):
    """A joint fit that gains 20 nats on some presses and loses a little on the others."""

    def fit_jointly(self, fit: Any, tried: Any) -> Any:
        assert all(t.name != "saturation" for t, _ in tried)
        return self.fit_to_end(tried)


@pytest.mark.parametrize(("on", "named"), [(C.few, False), (C.few + 3, True)])
def test_gain_of_few_presses_is_no_evidence(on: int, named: bool):
    fits = fits_of(Lumpy, np.where(np.arange(20) < on, 20.0, -0.4))
    scored = Entry(name="cover", gain=40.0, clipped_gain=6.0, significance=1.5, limit=30.0, p_value=0.01)
    assert bool(fits.shortlist(BEFORE, [scored])) is named
    # Effects that bounds keep from what their slopes promise take no place of others, whatever they promise.
    large = {"name": "saturation", "gain": 900.0, "clipped_gain": 90.0}
    cannot = [Entry(**vars(scored) | large)] * C.contenders
    assert bool(fits.shortlist(BEFORE, [*cannot, scored])) is named


class Forking:
    """Two effects gain as much alone; a third gains more beside the second."""

    null = None
    gains: ClassVar = {
        (): 0.0,
        ("creep",): 40.0,
        ("latency",): 39.0,
        ("creep", "cover"): 60.0,
        ("latency", "cover"): 90.0,
    }

    def score(self, fit: Any) -> Any:
        return np.full(20, self.gains[fit.effects] / 20)

    def gain(self, new: Any, old: Any) -> Any:
        return Score(self.score(new) - self.score(old))

    def score_candidates(self, fit: Any) -> Any:
        names = ("cover",) if fit.effects else ("creep", "latency")
        return [SimpleNamespace(passes_null="cover" not in fit.effects, name=n, gain=0.0) for n in names]

    def shortlist(self, fit: Any, scores: Any) -> Any:
        new = {t.name: SimpleNamespace(effects=(*fit.effects, t.name), free=()) for t in scores}
        gain = {n: self.gain(x, fit).total for n, x in new.items()}
        return [(selected(n, gain[n], *(m for m in new if m != n)), x) for n, x in new.items()]

    def without(self, fit: Any, names: Any, *, few_steps: bool = False) -> Any:
        left = [tuple(n for n in ("creep", "latency") if n in fit.effects and n != name) for name in names]
        return [SimpleNamespace(effects=effects) for effects in left]

    def restarted(self, fit: Any) -> Any:
        return fit


def test_later_effects_resolve_an_equivalence_set():
    found = search(Forking(), SimpleNamespace(effects=()))
    assert [n.equivalents for n in found.selected] == [("latency",), ("cover",)]
