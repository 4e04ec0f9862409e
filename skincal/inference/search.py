"""Stepwise search for the effects that a session shows.

::

    fit the base model; simulate null sessions about it
    repeat
        score every absent effect, at each of its starts, by its linear gain on held-out presses
        of those beyond their null limit fit the best few jointly with the base
        keep significant gains; fit the best and its equivalents to convergence
        add the effect whose fit predicts best; those that predict as well are its equivalence set
        drop effects that the new one has made redundant
    until no gain is significant; follow the next best of the set as well, and keep the better path
    try to swap each effect for one that gains more beside the later ones
    refit once from the prior pose if the base has gone far from it

Scores are those of :mod:`skincal.inference.score`, limits those of :mod:`skincal.inference.null`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from skincal.fitting.tasks import Mapper
from skincal.inference.candidate_fits import CandidateFits, equation_loss, is_equivalent
from skincal.inference.candidate_scores import CandidateScorer, smooth_fitter
from skincal.inference.constants import CONSTANTS as C
from skincal.inference.fit import Fitted, Fitter
from skincal.inference.score import Score, folds_of
from skincal.inference.search_result import SearchPath, SearchResult, SelectedEffect, with_selected


def search_effects(
    fitter: Fitter,
    base: Fitted,
    names: Sequence[str],
    covariates: frozenset[str],
    rng: np.random.Generator,
    *,
    progress: Callable[[str], None] = lambda _: None,
    null_sessions: int = C.null_sessions,
    mapper: Mapper = map,
) -> SearchResult:
    """Search for the effects that a session shows.

    Args:
        fitter: of the session.
        base: its fit without new effects.
        names: effects that may be missing.
        covariates: names of those that the session has.
        rng: draws folds and null sessions.
        progress: callback for messages.
        null_sessions: how many are simulated.
        mapper: runs independent fits side by side.
    """
    folds, without_steps = folds_of(base.blocks, rng), smooth_fitter(fitter)
    scorer = CandidateScorer(fitter, without_steps, base, names, folds, rng, null_sessions, mapper, progress)
    fits = CandidateFits(fitter, without_steps, folds, covariates, frozenset(base.state.effects), mapper)
    return Search(base, scorer, fits).run()


@dataclass(eq=False)
class Search:
    """Forward selection, backward elimination and swaps.

    Attributes:
        base: fit without new effects.
        scorer: scores candidates by their slopes.
        fits: fits them jointly.
    """

    base: Fitted
    scorer: CandidateScorer
    fits: CandidateFits

    def run(self) -> SearchResult:
        """Search from the base model."""
        active, finished = [SearchPath(self.base)], list[SearchPath]()
        while active:
            grown = [new for path in active for new in self._extend(path)]
            finished += [path for path in grown if path.is_finished]
            # Effects selected in another order are the same path.
            by_names = {path.names: path for path in sorted(grown, key=self._total) if not path.is_finished}
            active = sorted(by_names.values(), key=self._total, reverse=True)[: C.paths]
        best = self._best_path(finished)
        fit, selected = best.fit, [self._prune(best, k, finished) for k in range(len(best.selected))]
        for old in selected[:-1]:
            fit, selected = self._swap(fit, selected, old)
        fit = self.fits.restarted(fit) if selected else fit
        end = replace(best, fit=fit, selected=tuple(selected))
        if fit is not best.fit:
            # About another fit other effects may be redundant.
            end = self._drop_redundant(end, end.selected)
        return SearchResult(self.base, end.fit, end.selected, best.rounds, self.scorer.null)

    def _extend(self, path: SearchPath) -> list[SearchPath]:
        """Add one effect: one path for the best, and one for each of its equivalents."""
        scores = self.scorer.score_candidates(path.fit)
        rounds = (*path.rounds, tuple(scores))
        worth = [s for s in scores if s.passes_null and s.name not in path.dropped]
        room = len(path.selected) < C.most and len(rounds) <= 2 * C.most
        best = self.fits.shortlist(path.fit, worth) if worth and room else []
        if not best:
            return [replace(path, rounds=rounds, is_finished=True)]
        more = [(fit, with_selected(path.selected, new)) for new, fit in best[: C.paths]]
        return [
            self._drop_redundant(replace(path, fit=fit, selected=selected, rounds=rounds), selected[:-1])
            for fit, selected in more
        ]

    def _drop_redundant(self, path: SearchPath, asked: Sequence[SelectedEffect]) -> SearchPath:
        """Drop those of some effects whose gain beside the others is below their limit."""
        asked = self._perhaps_redundant(path.fit, asked)
        for old, less in zip(asked, self.fits.without(path.fit, [n.name for n in asked]), strict=True):
            if self.fits.gain(path.fit, less).total < old.limit:
                left = self._with_gains(less, [n for n in path.selected if n is not old])
                path = replace(path, fit=less, selected=left, dropped=path.dropped | {old.name})
                names = [n.name for n in asked]
                return self._drop_redundant(path, [n for n in left if n.name in names])
        return path

    def _perhaps_redundant(self, fit: Fitted, asked: Sequence[SelectedEffect]) -> list[SelectedEffect]:
        """Keep effects whose removal loses little of their gain after a few steps of a fit."""
        rough = self.fits.without(fit, [n.name for n in asked], few_steps=True)
        lost = [self.fits.gain(fit, less).total for less in rough]
        return [n for n, x in zip(asked, lost, strict=True) if x < C.contend * n.gain]

    def _with_gains(self, fit: Fitted, selected: Sequence[SelectedEffect]) -> tuple[SelectedEffect, ...]:
        """Measure the gain of each effect beside the others anew."""
        reduced = self.fits.without(fit, [n.name for n in selected])
        return tuple(
            replace(n, gain=self.fits.gain(fit, x).total) for n, x in zip(selected, reduced, strict=True)
        )

    def _total(self, path: SearchPath) -> float:
        return float(self.fits.score(path.fit).sum())

    def _best_path(self, finished: Sequence[SearchPath]) -> SearchPath:
        """Return the path that predicts best.

        A path with more effects must gain the limit of each additional one. It must also gain what errors of their
        equations may have cost the effects that only the shorter path has (:func:`equation_loss`).
        """
        best, *others = sorted(finished, key=lambda p: (len(p.selected), -self._total(p)))
        for path in others:
            more = len(path.selected) - len(best.selected)
            least = sum(sorted(n.limit for n in path.selected)[:more])
            least += sum(
                equation_loss(n.name, n.gain) for n in best.selected if more and n.name not in path.names
            )
            gain = self.fits.gain(path.fit, best.fit)
            if gain.total > least and (not more or gain.significance > C.alike):
                best = path
        return best

    def _prune(self, best: SearchPath, k: int, finished: Sequence[SearchPath]) -> SelectedEffect:
        """Remove from an equivalence set the effects whose own paths end significantly worse."""
        own, scores = best.selected[k], self.fits.score(best.fit)
        gone = set[str]()
        for path in finished:
            other = path.selected[k].name if len(path.selected) > k else own.name
            is_rival = (
                other in own.equivalents and other != own.name and best.selected[:k] == path.selected[:k]
            )
            if is_rival and not is_equivalent(Score(scores - self.fits.score(path.fit)), other, own.gain):
                gone.add(other)
        names = tuple(n for n in own.equivalents if n not in gone)
        return replace(own, equivalents=names, rivals=tuple((n, x) for n, x in own.rivals if n not in gone))

    def _swap(
        self, fit: Fitted, selected: list[SelectedEffect], old: SelectedEffect
    ) -> tuple[Fitted, list[SelectedEffect]]:
        """Exchange an effect for one that gains more than it does beside the later ones, if there is one."""
        (less,) = self.fits.without(fit, [old.name])
        others = [n for n in selected if n is not old]
        scores = self.scorer.score_candidates(less)
        own = max((s.gain for s in scores if s.name == old.name), default=0.0)
        best = self.fits.shortlist(less, [s for s in scores if s.passes_null and s.gain > own])
        if not best or best[0][0].name in [n.name for n in others]:
            return fit, selected
        new, joint = best[0]
        if self.fits.gain(joint, fit).total <= 0:
            return fit, selected
        return joint, [new if n is old else n for n in selected]
