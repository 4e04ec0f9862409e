"""Naming what is missing: effects are added one by one, each must earn its place on presses it was not fitted to.

In each round the effects that promise most to first order are searched on the training presses and scored on the
selection presses (:mod:`skincal.gap.candidates`). The best few, and others if those explain little
(:mod:`skincal.gap.contest`), are fitted in full, together with the sensor, the places and all effects named before, and
the one that leaves least is named, or a simpler one that leaves about as little; what can be read off goes before all.
Those that leave nearly as little stay in its set of names. It ends when nothing significant is left, when no effect
explains a fair part of what is left, or at the most effects allowed. At the end each named effect is dropped in turn,
and stays out if nothing is lost, and what came near it is tried in its place (:mod:`skincal.gap.rivals`).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

from skincal.gap.candidates import Found, Start, best_of, search
from skincal.gap.choice import Choice, Named, Round
from skincal.gap.choice_options import ChoiceOptions
from skincal.gap.contest import Contest, Heard, Needed, PValue, further
from skincal.gap.hypothesis import Hypothesis
from skincal.gap.library import Library
from skincal.gap.models import (
    Material,
    Model,
    begun_again,
    better,
    excess_of,
    finished,
    found_again,
    levelled,
    pooled,
    scene_of,
    without,
)
from skincal.gap.related import instead, likeness, of_one_kind
from skincal.gap.rivals import beside_all, rivals
from skincal.gap.simpler import fewest, of_taxels, simplest


def choose(
    before: Model,
    material: Material,
    library: Library,
    p_value: PValue,
    null_mean: float,
    options: ChoiceOptions | None = None,
    extra: Mapping[str, Start] | None = None,
    heard: Heard = lambda _: None,
    plain: Collection[str] = (),
    law: float = 0.0,
    fresh: Hypothesis | None = None,
) -> Choice:
    """Names effects one by one.

    Args:
        before: the base model, fitted.
        material: the session.
        library: sensitivities of the effects that may be named.
        p_value: of a score.
        null_mean: mean square of a null session's residual.
        options: when an effect is named.
        extra: starts of effects that are not in the library.
        heard: told what is being done.
        plain: effects that can be read off without a model, such as a high level at rest. What comes after them is
            measured against what they leave.
        law: root mean square of what another contact law explains, in units of the noise.
        fresh: where a fit may begin again once an effect is named; None: only from where the last one ended.
    """
    options = options or ChoiceOptions()
    task = _Task(material, library, p_value, null_mean, options, extra or {}, heard, plain, law, fresh)
    naming = _Naming(task, before)
    while naming.goes_on and naming.round():
        pass
    return naming.ended(before)


@dataclass(frozen=True, eq=False)
class _Task:
    """Arguments of :func:`choose`."""

    material: Material
    library: Library
    p_value: PValue
    null_mean: float
    options: ChoiceOptions
    extra: Mapping[str, Start]
    heard: Heard
    plain: Collection[str]
    law: float
    fresh: Hypothesis | None

    def excess(self, model: Model) -> float:
        """What a model leaves beyond what a null session does."""
        return excess_of(model, self.material, self.null_mean)

    def searched(self, model: Model, passed: Collection[str], *, every: bool = False) -> list[Found]:
        """What effects explain to first order beside a model."""
        return _searched(model, self.material, self.library, self.options, self.extra, passed, every=every)


@dataclass(frozen=True, eq=False)
class _Tried:
    """Effects of a round.

    Attributes:
        contest: of them.
        found: their search.
        fits: full fits.
        again: those with which presses were looked for again.
        read: the one that can be read off; None where there is none.
    """

    contest: Contest
    found: Sequence[Found]
    fits: Mapping[str, Model]
    again: Collection[str]
    read: str | None

    @cached_property
    def falls(self) -> dict[str, float]:
        """By how much each lowers the excess."""
        return {name: self.contest.fall(model) for name, model in self.fits.items()}

    def scores(self, name: str) -> bool:
        """Whether the search of an effect scored."""
        return self.contest.scores(self.search(name))

    def search(self, name: str) -> Found:
        """That of an effect."""
        return next(f for f in self.found if f.effect == name)


class _Naming:
    """What was named so far, and the rounds in which it was."""

    def __init__(self, task: _Task, before: Model) -> None:
        self.task, self.model = task, before
        self.named: list[Named] = []
        self.rounds: list[Round] = []
        self.passed: set[str] = set()
        self.of_rest: set[str] = set()
        self.values = int((task.material.reading.seen & task.material.known[:, None]).sum())
        self.least = task.options.least(self.values, task.law)
        self.whole = self.first = self.left = task.excess(before)
        # Where the first effect that had to be looked for was: beside what was read off.
        self.read_off, self.origin, self.first_round = 0, before, 0

    @property
    def beside(self) -> int:
        """Effects that were named, without those that were read off."""
        return len(self.named) - self.read_off

    @property
    def goes_on(self) -> bool:
        """Whether there may be a further effect."""
        options = self.task.options
        enough = options.later(options.enough, self.first, self.values)
        return len(self.named) < options.most and self.left > enough and self.first > 0

    def round(self) -> bool:
        """Names an effect, or passes one over; whether it did."""
        options, number = self.task.options, len(self.rounds) + 1
        self.task.heard(f"round {number}: searching")
        found = self.task.searched(self.model, self.passed)
        if not found:
            return False
        tried = self._tried(found, number)
        self.rounds.append(Round(tuple(tried.found), self.left, tried.falls, tried.fits))
        name = self._best(tried)
        if name is None:
            return False
        best, kept = tried.fits[name], self.named
        if self.beside and tried.falls[name] < options.of_related * self.first:
            known = [one.name for one in self.named[self.read_off :]]
            kin = [one for one in known if of_one_kind(name, [one])]
            alone = (
                instead(best, kin, self.task.material, self.left - self.least, self.task.null_mean)
                if kin
                else best
            )
            if alone is None:
                # What the equation of the first is not quite right in; something else may still be there.
                self.passed.add(name)
                self.rounds[-1] = replace(self.rounds[-1], passed_over=name)
                return True
            if not kin and self._likeness(name, known) > options.related:
                return False
            best, kept = alone, [one for one in self.named if one.name not in kin]
        self.rounds[-1] = replace(self.rounds[-1], taken=name)
        self.named = [*kept, self._as_named(name, tried)]
        done = name in tried.again and best is tried.fits[name]
        self.model = best if done else self._again(best, name, number)
        self.left = self.task.excess(self.model)
        if tried.read is not None:
            self.first, self.read_off = self.left, self.read_off + 1
            self.origin, self.first_round = self.model, number
        return True

    def ended(self, before: Model) -> Choice:
        """What is missing: what was named, without what the others do without."""
        task, options = self.task, self.task.options
        of_all = options.later(options.of_all, self.first, self.values)
        lost = {n.name: min(self.least, of_all) if n.name in self.of_rest else of_all for n in self.named}
        doubtful = [n for n in outdone(self.named, self.rounds) if n not in task.plain]
        anew = dict.fromkeys(doubtful, task.fresh) if task.fresh is not None else {}
        model, named = dropped(self.model, self.named, task.material, lost, anew)
        plain = [one for one in named if one.name in task.plain]
        looked_for = [one for one in named if one.name not in task.plain]
        model, looked_for = against_rivals(
            model, looked_for, self.rounds, task.material, options, self.values
        )
        named = (*plain, *looked_for)
        model = pooled(levelled(model, task.material), task.material)
        if named:
            task.heard("the last fit")
            model = finished(model, task.material)
        excess = self.whole, task.excess(model)
        return Choice(before, model, named, tuple(self.rounds), excess, self.values, task.law)

    def _tried(self, found: list[Found], number: int) -> _Tried:
        """Full fits of effects that score, and of others where those explain little."""
        task, options = self.task, self.task.options
        # Where one was passed over, the model is that of the round before.
        last = self.rounds[-1] if self.rounds else None
        done: Mapping[str, Model] = last.fits if last is not None and last.passed_over else {}
        contest = Contest(self.model, task.material, task.p_value, task.null_mean, options, self.left, done)
        if contest.scores(found[0]):
            task.heard(f"round {number}: fitting {found[0].effect} and what comes near it")
        readable = task.plain if self.beside == 0 else ()
        fits = contest.fits([f for f in found if contest.near(f, found) or f.effect in readable])
        # What can be read off is there; what takes it up on the way must wait until it is in the model.
        read = next((n for n in readable if n in fits and contest.fall(fits[n]) >= self.least), None)
        if read is not None:
            return _Tried(contest, found, fits, (), read)
        every = partial(task.searched, self.model, self.passed, every=True)
        # What is named and all that is added must explain enough together, or the answer is that nobody knows.
        lacking = 1 - (1 - options.explained) * self.first / self.left
        needed = Needed(self.beside, self.least, lacking, partial(_told, task.heard, number), task.fresh)
        more, searches, again = further(contest, found, fits, every, needed)
        return _Tried(contest, searches, more, again, None)

    def _best(self, tried: _Tried) -> str | None:
        """The effect that explains most, or a simpler one that explains as much; None where it is not enough."""
        options, falls = self.task.options, tried.falls
        most = max(falls.values(), default=0.0)
        if most <= 0:
            return None
        if tried.read is not None:
            return tried.read
        # An effect with numbers for each taxel must beat those that need fewer.
        close = [n for n in falls if falls[n] >= min(most, options.enough_of(most, self.left, self.values))]
        asked = options.share_later if self.beside else options.share_first
        least = max(self.least, options.later(options.of_all, self.first, self.values))
        enough = max(asked * self.left, least)
        name = fewest(simplest(close, falls, tried.fits), falls, tried.fits, options, self.values, enough)
        share, scores = falls[name] / self.left, tried.scores(name)
        if self.beside and of_taxels(tried.fits[name], name) and not scores:
            asked = options.share_of_taxels
        if self.beside and share >= options.most_of_rest and scores:
            self.of_rest.add(name)
            least = self.least
        return name if share >= asked and falls[name] >= least else None

    def _as_named(self, name: str, tried: _Tried) -> Named:
        """An effect with the names that cannot be told from it."""
        options, falls = self.task.options, tried.falls
        if tried.read is not None:
            # It stands far out of the noise: only what leaves as much, no less, cannot be told from it.
            alike = [n for n in falls if abs(falls[n] - falls[name]) <= options.least(self.values)]
        else:
            alike = [n for n in falls if falls[n] >= options.about(max(falls.values()), self.values)]
        others = sorted((n for n in alike if n != name), key=lambda n: -falls[n])
        # What was read off need not hold for other presses: a taxel may die in the last ones.
        # What a full fit alone has found did not score: its p-value is that of what it explains.
        scored = tried.read is None and tried.scores(name)
        told_by = tried.search(name).scored if scored else falls[name]
        p_value = self.task.p_value(name, told_by)
        return Named(name, (name, *others), falls[name] / self.left, p_value)

    def _likeness(self, name: str, known: Sequence[str]) -> float:
        """How like others an effect is, each alone."""
        scene = scene_of(self.origin, self.task.material)
        return likeness(scene, self.task.material, self.rounds[self.first_round], name, known)

    def _again(self, model: Model, name: str, number: int) -> Model:
        """The model with presses looked for again, also from another beginning where much is left."""
        task = self.task
        task.heard(f"round {number}: presses again, with {name}")
        here = found_again(model, task.material)
        if task.fresh is None or task.excess(here) <= self.least:
            return here
        return better(here, found_again(begun_again(here, task.material, task.fresh), task.material))


def _told(heard: Heard, number: int, what: str) -> None:
    heard(f"round {number}: {what}")


def against_rivals(
    model: Model,
    named: Sequence[Named],
    rounds: Sequence[Round],
    material: Material,
    options: ChoiceOptions,
    values: int,
) -> tuple[Model, list[Named]]:
    """A model whose effects explain no less than what came near them, now that all the others are in it.

    The last one was chosen beside all the others. Effects with more numbers for single taxels do not take the place of
    one with fewer.

    Args:
        model: with all that was named.
        named: in the order in which they were, without what was read off.
        rounds: in which they were.
        material: the session.
        options: say what cannot be told apart.
        values: that were read.
    """
    kept = list(named)
    for k, one in enumerate(named[:-1]):
        its = next(r for r in rounds if r.taken == one.name)
        most = of_taxels(its.fits[one.name], one.name)
        near = {
            n: its.fits[n]
            for n in rivals(its.falls, one.name, model, options)
            if of_taxels(its.fits[n], n) <= most
        }
        if near:
            model, names = beside_all(model, one.name, near, material, options, values)
            before = (n for n in one.consistent_with if n not in names and n not in model.names)
            kept[k] = replace(one, name=names[0], consistent_with=(*names, *before))
    return model, kept


def dropped(
    model: Model,
    named: Sequence[Named],
    material: Material,
    least: Mapping[str, float],
    anew: Mapping[str, Hypothesis],
) -> tuple[Model, list[Named]]:
    """What is left of a model once every effect is dropped in turn that the others do without.

    Args:
        model: with all that was named.
        named: in the order in which they were. One alone is needed; of several the last one, too, may be no more, as
            presses were looked for again after it was named.
        material: the session.
        least: by how much the objective must rise for each effect to stay.
        anew: where the fit without an effect may also begin, of some.
    """

    def needs(other: Model, one: Named) -> bool:
        return excess_of(other, material, 0.0) - excess_of(model, material, 0.0) >= least[one.name]

    kept = list(named)
    for one in named:
        if len(kept) == 1:
            break
        other = without(model, one.name, material)
        if needs(other, one):
            # The model's presses were looked for with the effect; without it they deserve the same.
            other = found_again(other, material)
        if needs(other, one) and one.name in anew:
            other = better(other, found_again(begun_again(other, material, anew[one.name]), material))
        if not needs(other, one):
            model, kept = other, [k for k in kept if k is not one]
    return model, kept


def outdone(named: Sequence[Named], rounds: Sequence[Round]) -> list[str]:
    """Names of effects of which a later one explained more: sensor and places were far off as they were named."""
    falls = {r.taken: r.falls[r.taken] for r in rounds if r.taken is not None}
    return [
        one.name
        for k, one in enumerate(named)
        if any(falls[later.name] > falls[one.name] for later in named[k + 1 :])
    ]


def _searched(
    model: Model,
    material: Material,
    library: Library,
    options: ChoiceOptions,
    extra: Mapping[str, Start],
    passed: Collection[str],
    *,
    every: bool = False,
) -> list[Found]:
    """What effects explain to first order, best first: those that explain most, or ``every`` one there is."""
    scene = scene_of(model, material)
    views = scene.part(material.learn), scene.part(material.score)
    residuals = views[0].residual, views[1].residual
    done = {*model.names, *passed}
    first = {
        name: float(library.falls(name, views, residuals)[0][0])
        for name in library.columns
        if name not in done
    }
    order = sorted(first, key=lambda n: -first[n])
    names = [
        n
        for i, n in enumerate(order[: options.searched])
        if i < options.contenders or first[n] > options.near * first[order[0]]
    ]
    names = order if every else names
    found = [one for name in names if (one := best_of(scene, name, *views, far=every)) is not None]
    found += [search(scene, start, *views) for name, start in extra.items() if name not in done]
    return sorted(found, key=lambda f: -f.scored)
