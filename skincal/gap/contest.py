"""Effects of a round against each other: which of them score, and what full fits of them leave."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from skincal.gap.candidates import Found
from skincal.gap.choice_options import ChoiceOptions
from skincal.gap.hypothesis import Hypothesis
from skincal.gap.models import (
    Material,
    Model,
    begun_again,
    better,
    excess_of,
    extended,
    fitted,
    found_again,
    scene_of,
)

IN_PLACES = "contact_offset"
"""Is told by the places of presses (:mod:`skincal.gap.places`), and takes long to fit."""

PValue = Callable[[str, float], float]
"""The p-value of an effect's score, from its name and the score."""

Heard = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Contest:
    """Effects of a round against each other.

    Attributes:
        model: that they are added to.
        material: the session.
        p_value: of a score.
        null_mean: mean square of a null session's residual.
        options: when an effect is named.
        left: excess of the model.
        done: full fits that need not be made again.
    """

    model: Model
    material: Material
    p_value: PValue
    null_mean: float
    options: ChoiceOptions
    left: float
    done: Mapping[str, Model] = field(default_factory=dict[str, Model])

    def scores(self, one: Found) -> bool:
        """Whether an effect explains more of other presses than any does in null sessions."""
        return one.scored > 0 and self.p_value(one.effect, one.scored) <= self.options.significant

    def near(self, one: Found, found: Sequence[Found]) -> bool:
        """Whether an effect is among the few that score about as high as the best; all of them, best first."""
        few = one.scored >= self.options.contend * found[0].scored and one in found[: self.options.contenders]
        return few and self.scores(found[0])

    def fall(self, model: Model) -> float:
        """By how much a model lowers the excess."""
        return self.left - excess_of(model, self.material, self.null_mean)

    def little(self, fits: Mapping[str, Model], share: float) -> bool:
        """Whether none of these explains such a share of what is left."""
        return max((self.fall(m) for m in fits.values()), default=0.0) < share * self.left

    def fits(self, found: Sequence[Found]) -> dict[str, Model]:
        """Full fits of some, each with what was named before."""
        new = [one for one in found if one.effect not in self.done]
        made = {
            one.effect: model
            for one, model in zip(new, self._fitted(self.model, new, self.material), strict=True)
        }
        return {one.effect: made.get(one.effect) or self.done[one.effect] for one in found}

    def holding(self, found: Sequence[Found], share: float, *, every: bool = False) -> list[Found]:
        """Those of which a full fit to the presses learned from explains such a share of the others; scored with it.

        Tried are those that explain most of the presses learned from, by the search, as many as contend; if ``every``
        one may be it, the next as many after them, until one does.

        The search holds sensor and places to first order. Far from where they belong, a gain that few presses show is
        found many times too large, and holds for no others. What is said of other presses is compared with what is said
        without the effect, learned from as few: sensor and effects are not found on them again.
        """
        order = sorted((f for f in found if f.effect != IN_PLACES), key=lambda f: -f.learned)
        if not order:
            return []
        some = replace(self.material, score=np.zeros_like(self.material.score))
        m = self.model
        without = fitted(m.hypothesis, m.coords, m.refit.x, m.held, some)
        before = self._of_others(without)
        read = float(self.material.reading.seen[self.material.score].sum())
        least = max(1.0, share * (before - self.null_mean * read))
        # From where all presses led, which is nearer to where the sensor belongs; what it must lower is that of these.
        begin = replace(m, refit=replace(m.refit, objective=without.refit.objective))
        for first in range(0, len(order) if every else 1, self.options.contenders):
            tried = order[first : first + self.options.contenders]
            learned = self._fitted(begin, tried, some)
            again = [
                replace(f, scored=before - self._of_others(m)) for f, m in zip(tried, learned, strict=True)
            ]
            if holding := [f for f in again if f.scored >= least and self.scores(f)]:
                return holding
        return []

    def about_as_much(self, fits: Mapping[str, Model]) -> list[str]:
        """Names of those that explain enough for a first effect and about as much as the best, as many as contend."""
        order = sorted(fits, key=lambda n: -self.fall(fits[n]))[: self.options.contenders]
        most = self.fall(fits[order[0]]) if order else 0.0
        least = max(self.options.half * most, self.options.share_first * self.left)
        return [n for n in order if self.fall(fits[n]) >= least]

    def stays(self, fits: Mapping[str, Model]) -> float:
        """The excess that the best of these leaves."""
        return self.left - max((self.fall(m) for m in fits.values()), default=0.0)

    def some(self, fits: Mapping[str, Model]) -> list[str]:
        """Names of those that explain something, twice as many as contend."""
        order = sorted(fits, key=lambda n: -self.fall(fits[n]))[: 2 * self.options.contenders]
        return [n for n in order if self.fall(fits[n]) >= self.options.holds * self.left]

    def looked_again(self, fits: Mapping[str, Model], fresh: Hypothesis | None) -> dict[str, Model]:
        """Full fits with presses looked for again, of those that explain about as much as the best.

        As long as an effect is not in the model, places and sensor take up a part of it, and which effect explains most
        from there need not be the one that does once they are where they belong. Most of that a fit tells that begins
        again, before presses are looked for, which costs more.

        Args:
            fits: full fits.
            fresh: where a fit may begin again; None: only from where it ended.
        """
        mapper, alone = self.material.options.mapper, self.material.alone
        best = dict(fits)
        if fresh is not None:
            begun = mapper(_begun_again, [(model, alone, fresh) for model in fits.values()])
            best = {n: better(fits[n], model) for n, model in zip(fits, begun, strict=True)}
        falls = {n: self.fall(model) for n, model in best.items()}
        some = [n for n in best if falls[n] >= self.options.half * max(falls.values())]
        return dict(zip(some, mapper(_found_again, [(best[n], alone) for n in some]), strict=True))

    def _of_others(self, model: Model) -> float:
        """What a model leaves of the presses that choose."""
        left = scene_of(model, self.material).part(self.material.score, told=True).residual
        return float((left**2).sum())

    @staticmethod
    def _fitted(model: Model, found: Sequence[Found], material: Material) -> list[Model]:
        if len(found) == 1:
            return [extended(model, found[0], material)]
        tasks = [(model, f, material.alone) for f in found]
        return list(material.options.mapper(_extended, tasks))


@dataclass(frozen=True, eq=False)
class Needed:
    """What full fits of a round are for.

    Attributes:
        beside: effects that were named, without those that were read off.
        least: by how much the weakest effect lowers the squared residual.
        lacking: part of what is left that an effect must explain for what is named to explain enough; nothing lacks
            where it is negative.
        heard: told what is being done.
        fresh: where a fit may begin again; None: only from where it ended.
    """

    beside: int
    least: float
    lacking: float
    heard: Heard
    fresh: Hypothesis | None = None


def further(
    contest: Contest,
    found: Sequence[Found],
    fits: Mapping[str, Model],
    every: Callable[[], list[Found]],
    needed: Needed,
) -> tuple[dict[str, Model], list[Found], frozenset[str]]:
    """More effects fitted in full where those that score best explain little.

    It returns all full fits, the search with them, and the effects with which presses were looked for again.

    Args:
        contest: of the round.
        found: its search, best score first.
        fits: the full fits of those that score best.
        every: searches every effect there is.
        needed: what they are for.
    """
    options, fits, found = contest.options, dict(fits), list(found)
    if needed.beside == 0 and contest.little(fits, options.halfway):
        needed.heard("fitting all others that score, as these explain little")
        fits |= contest.fits([f for f in found if f.effect not in fits and contest.scores(f)])
    # For the first, and for one beside one; a third is more often what equations are not quite right in.
    wanted = {0: options.halfway, 1: options.share_later}.get(needed.beside, 0.0)
    if wanted and contest.little(fits, wanted) and contest.left > options.sure * needed.least:
        needed.heard("fitting others to some presses, as these explain little")
        # Nothing is known of a session of which the first effects explain little: any other may be it.
        first_of_all = needed.beside == 0
        several = every() if first_of_all else found
        share = options.holds if first_of_all else options.share_later
        holding = contest.holding([f for f in several if f.effect not in fits], share, every=first_of_all)
        fits |= contest.fits(holding)
        found = _with(found, holding)
    # What the two together would leave is more than an equation that is not quite right does.
    much = contest.little(fits, options.explained) and contest.stays(fits) > options.sure * needed.least
    lacking = needed.lacking > 0 and contest.little(fits, max(needed.lacking, wanted))
    if needed.beside == 1 and (lacking or much):
        needed.heard("fitting every other, as one effect does not explain enough")
        others = [f for f in every() if f.effect not in fits and f.effect != IN_PLACES]
        fits |= contest.fits(others)
        found = _with(found, others)
    near, again = list[str](), dict[str, Model]()
    if needed.beside == 0:
        near = contest.about_as_much(fits) if contest.little(fits, options.explained) else []
        near = near if len(near) > 1 else []
    elif needed.beside == 1 and (lacking or much):
        near = contest.some(fits)
    if near:
        needed.heard(f"presses again, with each of {', '.join(near)}")
        again = contest.looked_again({n: fits[n] for n in near}, needed.fresh)
        fits |= {n: m for n, m in again.items() if contest.fall(m) > contest.fall(fits[n])}
    return fits, found, frozenset(again)


def _with(found: Sequence[Found], more: Sequence[Found]) -> list[Found]:
    """Searches with others, which go before those of the same effect; best score first."""
    return sorted({f.effect: f for f in [*found, *more]}.values(), key=lambda f: -f.scored)


def _begun_again(task: tuple[Model, Material, Hypothesis]) -> Model:
    return begun_again(*task)


def _found_again(task: tuple[Model, Material]) -> Model:
    return found_again(*task)


def _extended(task: tuple[Model, Found, Material]) -> Model:
    return extended(*task)
