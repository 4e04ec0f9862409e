"""Naming what is missing: effects are added one by one, each must earn its place on presses it was not fitted to.

In each round every effect that the data can speak of is searched on the training presses and scored on the selection
presses (:mod:`skincal.gap.candidates`). The best few, and others if those explain little
(:mod:`skincal.gap.contest`), are fitted in full, together with the sensor, the places and all effects named before, and
the one that leaves least is named, or a simpler one that leaves about as little; what can be read off goes before all.
Those that leave nearly as little stay in its set of names. It ends when nothing significant is left, when no effect
explains a fair part of what is left, or at the most effects allowed. At the end each named effect is dropped in turn,
and stays out if nothing is lost, and what came near it is tried in its place (:mod:`skincal.gap.rivals`).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from skincal.gap.candidates import Found, Scene, Start, best_of, search
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
from skincal.gap.rivals import beside_all, rivals

KINDS: tuple[frozenset[str], ...] = (
    frozenset({"spread", "crosstalk", "ghosting"}),
    frozenset({"hysteresis", "creep", "rate"}),
    frozenset({"saturation", "dead_band", "response_curve", "stiffening", "cover"}),
)
"""Effects of which one takes up what another's equation leaves over: signals that go to other taxels, memories that
fade, curves from load to counts."""


@dataclass(frozen=True, eq=False)
class Named:
    """An effect that was named.

    Attributes:
        name: of the effect.
        consistent_with: names that these data cannot tell apart from it, itself first.
        share: part of the excess of its round that it explains.
        p_value: of the best score of a null session's effects reaching its score; of what was read off, or found by a
            full fit alone, reaching what that explains; of what only a full fit to some presses found, reaching what
            that explains of the others.
        by_places: whether the places of presses told it (:mod:`skincal.gap.places`), not the images.
    """

    name: str
    consistent_with: tuple[str, ...]
    share: float
    p_value: float
    by_places: bool = False


@dataclass(frozen=True, eq=False)
class Round:
    """What was tried in a round.

    Attributes:
        found: the search of each effect, best score first.
        excess: squared residual beyond noise before it, over the presses that choose.
        falls: fall of the squared residual by a full fit, of the contenders; presses were looked for again only with
            those that :func:`skincal.gap.contest.further` compares so.
        fits: the full fits.
        taken: the effect that was added; None where none was.
        passed_over: the effect that explained most, but only what one of its own kind leaves over; None where that
            did not happen.
    """

    found: tuple[Found, ...]
    excess: float
    falls: Mapping[str, float]
    fits: Mapping[str, Model] = field(default_factory=dict[str, Model])
    taken: str | None = None
    passed_over: str | None = None


@dataclass(frozen=True, eq=False)
class Choice:
    """What is missing.

    Attributes:
        before: the base model alone.
        after: with the effects that were named.
        named: them.
        rounds: what was tried.
        excess: squared residual beyond noise, before and after.
        values: that were read and looked at.
        law: root mean square of what another contact law explains, in units of the noise.
    """

    before: Model
    after: Model
    named: tuple[Named, ...]
    rounds: tuple[Round, ...]
    excess: tuple[float, float]
    values: int = 1
    law: float = 0.0

    @property
    def explained(self) -> float:
        """The part of the excess that the named effects explain; NaN where there is none."""
        first, last = self.excess
        return 1 - max(last, 0.0) / first if first > 0 else float("nan")

    @property
    def left(self) -> float:
        """Root mean square of what is left, in units of the noise."""
        return (max(self.excess[1], 0.0) / self.values) ** 0.5

    @property
    def closest(self) -> tuple[str, float] | None:
        """The effect that came closest to being named in the last round, and the part of what was left it explains.

        None where the last round had none that scored better than in null sessions.
        """
        last = self.rounds[-1] if self.rounds else None
        if last is None or last.taken is not None:
            return None
        name, fall = max(last.falls.items(), key=lambda item: item[1], default=("", 0.0))
        return (name, fall / last.excess) if fall > 0 else None


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
    named: list[Named] = []
    rounds: list[Round] = []
    passed: set[str] = set()
    of_rest: set[str] = set()
    model, told = before, 0
    seen = int((material.reading.seen & material.known[:, None]).sum())
    least = options.least(seen, law)
    whole = first = left = excess_of(before, material, null_mean)
    # Where the first effect that had to be looked for was: beside what was read off.
    origin, first_round = before, 0
    while len(named) < options.most and left > options.later(options.enough, first, seen) and first > 0:
        number = len(rounds) + 1
        heard(f"round {number}: searching")
        found = _searched(model, material, library, options, extra or {}, passed)
        if not found:
            break
        # Where one was passed over, the model is that of the round before.
        done: Mapping[str, Model] = rounds[-1].fits if rounds and rounds[-1].passed_over else {}
        contest = Contest(model, material, p_value, null_mean, options, left, done)
        if contest.scores(found[0]):
            heard(f"round {number}: fitting {found[0].effect} and what comes near it")
        beside = len(named) - told
        readable = plain if beside == 0 else ()
        fits: Mapping[str, Model] = contest.fits(
            [f for f in found if contest.near(f, found) or f.effect in readable]
        )
        # What can be read off is there; what takes it up on the way must wait until it is in the model.
        read = next((n for n in readable if n in fits and contest.fall(fits[n]) >= least), None)
        again: Collection[str] = ()
        if read is None:
            every = partial(_searched, model, material, library, options, extra or {}, passed, every=True)
            # What is named and all that is added must explain enough together, or the answer is that nobody knows.
            lacking = 1 - (1 - options.explained) * first / left
            needed = Needed(beside, least, lacking, partial(_told, heard, number), fresh)
            fits, found, again = further(contest, found, fits, every, needed)
        falls = {name: contest.fall(m) for name, m in fits.items()}
        rounds.append(Round(tuple(found), left, falls, fits))
        if not fits:
            break
        most = max(falls.values())
        if most <= 0:
            break
        alike = [n for n in fits if falls[n] >= options.about(most, seen)]
        # An effect with numbers for each taxel must beat those that need fewer.
        close = [n for n in fits if falls[n] >= min(most, options.enough_of(most, left, seen))]
        asked = options.share_later if beside else options.share_first
        least_of_all = max(least, options.later(options.of_all, first, seen))
        enough_for_one = max(asked * left, least_of_all)
        name = read or fewest(simplest(close, falls, fits), falls, fits, options, seen, enough_for_one)
        best = fits[name]
        share = falls[name] / left
        own = next(f for f in found if f.effect == name)
        if beside and of_taxels(best, name) and not contest.scores(own):
            asked = options.share_of_taxels
        if beside and share >= options.most_of_rest and contest.scores(own):
            of_rest.add(name)
            least_of_all = least
        enough = share >= asked and falls[name] >= least_of_all
        if read is None and not enough:
            break
        if beside and falls[name] < options.of_related * first:
            known = [one.name for one in named[told:]]
            kin = [one for one in known if of_one_kind(name, [one])]
            alone = instead(best, kin, material, left - least, null_mean) if kin else best
            if alone is None:
                # What the equation of the first is not quite right in; something else may still be there.
                passed.add(name)
                rounds[-1] = replace(rounds[-1], passed_over=name)
                continue
            if (
                not kin
                and likeness(scene_of(origin, material), material, rounds[first_round], name, known)
                > options.related
            ):
                break
            best, named = alone, [one for one in named if one.name not in kin]
        rounds[-1] = replace(rounds[-1], taken=name)
        if read:
            # It stands far out of the noise: only what leaves as much, no less, cannot be told from it.
            alike = [n for n in fits if abs(falls[n] - falls[name]) <= options.least(seen)]
        others = sorted((n for n in alike if n != name), key=lambda n: -falls[n])
        # What was read off need not hold for other presses: a taxel may die in the last ones.
        # What a full fit alone has found did not score: its p-value is that of what it explains.
        told_by = own.scored if read is None and contest.scores(own) else falls[name]
        named.append(Named(name, (name, *others), share, p_value(name, told_by)))
        model = best
        if name not in again or best is not fits[name]:
            heard(f"round {number}: presses again, with {name}")
            model = found_again(best, material)
            if fresh is not None and excess_of(model, material, null_mean) > least:
                model = better(model, found_again(begun_again(model, material, fresh), material))
        left = excess_of(model, material, null_mean)
        if read is not None:
            first, told, origin, first_round = left, told + 1, model, number
    of_all = options.later(options.of_all, first, seen)
    lost = {one.name: min(least, of_all) if one.name in of_rest else of_all for one in named}
    anew = {n: fresh for n in outdone(named, rounds) if n not in plain} if fresh is not None else {}
    model, named = dropped(model, named, material, lost, anew)
    read_off = [one for one in named if one.name in plain]
    looked_for = [one for one in named if one.name not in plain]
    model, looked_for = against_rivals(model, looked_for, rounds, material, options, seen)
    named = [*read_off, *looked_for]
    model = pooled(levelled(model, material), material)
    if named:
        heard("the last fit")
        model = finished(model, material)
    left = excess_of(model, material, null_mean)
    return Choice(before, model, tuple(named), tuple(rounds), (whole, left), seen, law)


def _told(heard: Heard, number: int, what: str) -> None:
    heard(f"round {number}: {what}")


def simplest(alike: Sequence[str], falls: Mapping[str, float], fits: Mapping[str, Model]) -> str:
    """Of effects that explain about as much the one that explains most, those with numbers for each taxel last.

    Args:
        alike: effects that explain about as much, at least one.
        falls: what each explains.
        fits: the model with each.
    """

    def order(name: str) -> tuple[int, float]:
        return of_taxels(fits[name], name), -falls[name]

    return min(alike, key=order)


def fewest(
    name: str,
    falls: Mapping[str, float],
    fits: Mapping[str, Model],
    options: ChoiceOptions,
    values: int,
    enough: float = 0.0,
) -> str:
    """Of effects that explain as much as one does, but for what is too little to be named, that with fewest numbers.

    Args:
        name: of the one.
        falls: what each explains.
        fits: the model with each.
        options: say what is as much, and what is too little.
        values: that were read.
        enough: what another one must explain to be named at all.
    """
    level = of_taxels(fits[name], name)
    least = max(options.broad * falls[name], falls[name] - options.least(values), enough)
    close = [name, *(n for n in fits if falls[n] >= least and of_taxels(fits[n], n) == level)]

    def order(other: str) -> tuple[int, float]:
        return sum(c.effect == other for c in fits[other].coords), -falls[other]

    return min(close, key=order)


def of_taxels(model: Model, name: str) -> int:
    """How many numbers of single taxels an effect of a model has."""
    own = [c for c in model.coords if c.effect == name and c.is_strength]
    return sum(c.parameter.shape == "per-taxel" for c in own)


def of_one_kind(name: str, known: Collection[str]) -> bool:
    """Whether an effect is of a kind with others: equations for the same thing, each right for some skins."""
    return any(name in kind and not kind.isdisjoint(known) for kind in KINDS)


def likeness(scene: Scene, material: Material, first: Round, name: str, known: Sequence[str]) -> float:
    """The largest squared cosine of what an effect and others do, each as a round's search ended with it alone.

    Args:
        scene: of the model that the round began with: the base model, beside what was read off.
        material: the session.
        first: the round, the first that looked for something; what it did not search is searched.
        name: of the effect.
        known: names of the others.
    """
    views = scene.part(material.learn), scene.part(material.score)
    searched = {f.effect: f for f in first.found}
    of = {n: searched.get(n) or best_of(scene, n, *views) for n in (name, *known)}
    done = {n: views[0].seen(scene.bench.values(f.parameters) - scene.zero)[:, 0] for n, f in of.items() if f}
    if name not in done:
        return 0.0
    unit = {n: own / max(float(np.linalg.norm(own)), 1e-300) for n, own in done.items()}
    return max((float(unit[name] @ unit[n]) ** 2 for n in known if n in unit), default=0.0)


def instead(
    model: Model, kin: Collection[str], material: Material, most: float, null_mean: float
) -> Model | None:
    """A model without effects that are of a kind with its last one; None where it leaves too much then.

    One that was named before may have come nearest only as long as sensor and presses were not where they belong.

    Args:
        model: with all of them.
        kin: names of those to be dropped.
        material: the session.
        most: excess that it may leave.
        null_mean: mean square of a null session's residual.
    """
    for name in kin:
        model = without(model, name, material)
    model = finished(found_again(model, material), material)
    return model if excess_of(model, material, null_mean) <= most else None


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
