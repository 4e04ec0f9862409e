"""Naming what is missing: effects are added one by one, each must earn its place on presses it was not fitted to.

In each round every effect that the data can speak of is searched on the training presses and scored on the selection
presses (:mod:`skincal.gap.candidates`). The best few, and in the first round all others that score if those explain
little, are fitted in full, together with the sensor, the places and all effects named before, and the one that leaves
least is named; those that leave nearly as little stay in its set of names. It ends when nothing significant is left,
when no effect explains a fair part of what is left, or at the most effects allowed. At the end each named effect is
dropped in turn, and stays out if nothing is lost.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from skincal.gap.candidates import Found, Scene, Start, best_of, search
from skincal.gap.hypothesis import Hypothesis
from skincal.gap.library import Library
from skincal.gap.models import (
    Material,
    Model,
    begun_again,
    excess_of,
    extended,
    found_again,
    scene_of,
    without,
)

Heard = Callable[[str], None]

KINDS: tuple[frozenset[str], ...] = (
    frozenset({"spread", "crosstalk", "ghosting"}),
    frozenset({"hysteresis", "creep", "rate"}),
    frozenset({"saturation", "dead_band", "response_curve", "stiffening", "cover"}),
)
"""Effects of which one takes up what another's equation leaves over: signals that go to other taxels, memories that
fade, curves from load to counts."""


@dataclass(frozen=True)
class ChoiceOptions:
    """When an effect is named.

    Attributes:
        most: effects at most.
        significant: p-value at which there is something.
        share_first: part of the excess that an effect must explain to be named at all, of what is there in its round.
        share_later: the same from the second round on: what an equation that is not quite right leaves over must not
            be named.
        of_all: part of the first round's excess that a later effect must explain, but no more than ``clear`` asks for.
        alike: effects stay in the set of names if they explain at least this part of what the best one does.
        contenders: so many are fitted in full at first.
        contend: effects that explain at least this part of the best are fitted in full.
        halfway: while nothing is named, and those explain less than this part of what is left, so are all others with a
            significant score: far from where the sensor belongs the search may rank an effect low that explains nearly
            all of it. Later it is not far, and a low score says that what is fitted holds for few other presses.
        searched: so many are searched, those that explain most to first order.
        near: effects that explain less than this part of the best to first order are not.
        enough: no further round where this part of the first round's excess is left, or less, but for ``clear``.
        weakest: root mean square of the weakest effect that is named, in units of the noise, over all that was read:
            tactile points half a millimetre apart and ramps averaged in bins leave nearly as much.
        beside_law: the same where another contact law explains much: what is not quite right in it leaves nearly as
            much.
        share_of_law: part of what a law explains that the weakest effect has at least, up to ``beside_law``.
        clear: root mean square in units of the noise from which on a later effect is looked at however large the first
            one was.
        related: cosine, squared, of what two effects do to the values, each alone, from which on the later one is taken
            for what the equation of the first leaves over, unless it explains ``of_related`` of the first excess; so is
            a later one of the same kind (:data:`KINDS`).
        of_related: see ``related``.
    """

    most: int = 4
    significant: float = 0.01
    share_first: float = 0.25
    share_later: float = 0.4
    of_all: float = 0.06
    alike: float = 0.88
    contenders: int = 3
    contend: float = 0.6
    halfway: float = 0.5
    searched: int = 8
    near: float = 0.1
    enough: float = 0.03
    weakest: float = 0.15
    beside_law: float = 0.25
    share_of_law: float = 0.8
    clear: float = 0.4
    related: float = 0.3
    of_related: float = 0.25

    def least(self, values: int, law: float = 0.0) -> float:
        """By how much the weakest effect lowers the squared residual of so many values.

        Args:
            values: that were read.
            law: root mean square of what another contact law explains, in units of the noise.
        """
        return self.weakest_beside(law) ** 2 * values

    def weakest_beside(self, law: float) -> float:
        """Root mean square of the weakest effect that is named, in units of the noise.

        Args:
            law: root mean square of what another contact law explains, in units of the noise.
        """
        return max(self.weakest, min(self.share_of_law * law, self.beside_law))

    def later(self, share: float, first: float, values: int) -> float:
        """A share of the first round's excess, but no more than is clear."""
        return min(share * first, self.clear**2 * values)


@dataclass(frozen=True, eq=False)
class Named:
    """An effect that was named.

    Attributes:
        name: of the effect.
        consistent_with: names that these data cannot tell apart from it, itself first.
        share: part of the excess of its round that it explains.
        p_value: of the best score of a null session's effects reaching its score.
    """

    name: str
    consistent_with: tuple[str, ...]
    share: float
    p_value: float


@dataclass(frozen=True, eq=False)
class Round:
    """What was tried in a round.

    Attributes:
        found: the search of each effect, best score first.
        excess: squared residual beyond noise before it, over the presses that choose.
        falls: fall of the squared residual by a full fit, of the contenders; presses were not yet looked for again.
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


PValue = Callable[[str, float], float]
"""The p-value of an effect's score, from its name and the score."""


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
    model, named, rounds, told, passed = before, list[Named](), list[Round](), 0, set[str]()
    seen = int((material.reading.seen & material.known[:, None]).sum())
    least = options.least(seen, law)
    whole = first = left = excess_of(before, material, null_mean)
    while len(named) < options.most and left > options.later(options.enough, first, seen) and first > 0:
        number = len(rounds) + 1
        heard(f"round {number}: searching")
        found = _searched(model, material, library, options, extra or {}, passed)
        if not found:
            break
        chance = p_value(found[0].effect, found[0].scored)
        rounds.append(Round(tuple(found), left, {}))
        if chance > options.significant or found[0].scored <= 0:
            break
        heard(f"round {number}: fitting {found[0].effect} and what comes near it")
        near = [f for f in found if f.scored >= options.contend * found[0].scored][: options.contenders]
        fits = _fitted(model, near, material)
        falls = {name: left - excess_of(m, material, null_mean) for name, m in fits}
        others = [f for f in found if f not in near and p_value(f.effect, f.scored) <= options.significant]
        if others and not named and max(falls.values()) < options.halfway * left:
            heard(f"round {number}: fitting all others, as these explain little")
            more = _fitted(model, others, material)
            falls |= {name: left - excess_of(m, material, null_mean) for name, m in more}
            fits += more
        rounds[-1] = Round(tuple(found), left, falls, dict(fits))
        name, best = max(fits, key=lambda item: falls[item[0]])
        share = falls[name] / left
        wanted = options.share_later if len(named) > told else options.share_first
        if share < wanted or falls[name] < max(least, options.later(options.of_all, first, seen)):
            break
        if len(named) > told and falls[name] < options.of_related * first:
            known = [one.name for one in named[told:]]
            if of_one_kind(name, known):
                # What the equation of the first is not quite right in; something else may still be there.
                passed.add(name)
                rounds[-1] = replace(rounds[-1], passed_over=name)
                continue
            if likeness(scene_of(before, material), material, rounds[0], name, known) > options.related:
                break
        rounds[-1] = replace(rounds[-1], taken=name)
        alike = [n for n, _ in fits if n != name and falls[n] >= options.alike * falls[name]]
        own = next(p_value(name, f.scored) for f in found if f.effect == name)
        named.append(Named(name, (name, *sorted(alike, key=lambda n: -falls[n])), share, own))
        heard(f"round {number}: presses again, with {name}")
        model = found_again(best, material)
        if fresh is not None and excess_of(model, material, null_mean) > least:
            model = min(model, begun_again(model, material, fresh), key=lambda m: m.refit.objective)
        left = excess_of(model, material, null_mean)
        if name in plain and len(named) == told + 1:
            first, told = left, told + 1
    model, named = dropped(model, named, material, options.later(options.of_all, first, seen))
    left = excess_of(model, material, null_mean)
    return Choice(before, model, tuple(named), tuple(rounds), (whole, left), seen, law)


def of_one_kind(name: str, known: Collection[str]) -> bool:
    """Whether an effect is of a kind with others: equations for the same thing, each right for some skins."""
    return any(name in kind and not kind.isdisjoint(known) for kind in KINDS)


def likeness(scene: Scene, material: Material, first: Round, name: str, known: Sequence[str]) -> float:
    """The largest squared cosine of what an effect and others do, each as the first round's search ended with it alone.

    Args:
        scene: of the base model.
        material: the session.
        first: the first round.
        name: of the effect.
        known: names of the others.
    """
    view = scene.part(material.learn)
    of = {f.effect: f for f in first.found if f.effect == name or f.effect in known}
    done = {n: view.seen(scene.bench.values(f.parameters) - scene.zero)[:, 0] for n, f in of.items()}
    if name not in done:
        return 0.0
    unit = {n: own / max(float(np.linalg.norm(own)), 1e-300) for n, own in done.items()}
    return max((float(unit[name] @ unit[n]) ** 2 for n in known if n in unit), default=0.0)


def dropped(
    model: Model, named: Sequence[Named], material: Material, least: float
) -> tuple[Model, list[Named]]:
    """What is left of a model once every effect is dropped in turn that the others do without.

    Args:
        model: with all that was named.
        named: in the order in which they were; the last one was named beside all others.
        material: the session.
        least: by how much the objective must rise for an effect to stay.
    """
    kept = list(named)
    for one in named[:-1]:
        other = without(model, one.name, material)
        if excess_of(other, material, 0.0) - excess_of(model, material, 0.0) >= least:
            # The model's presses were looked for with the effect; without it they deserve the same.
            other = found_again(other, material)
        if excess_of(other, material, 0.0) - excess_of(model, material, 0.0) < least:
            model, kept = other, [k for k in kept if k is not one]
    return model, kept


def _searched(
    model: Model,
    material: Material,
    library: Library,
    options: ChoiceOptions,
    extra: Mapping[str, Start],
    passed: Collection[str],
) -> list[Found]:
    scene = scene_of(model, material)
    views = scene.part(material.learn), scene.part(material.score)
    residuals = views[0].residual, views[1].residual
    done = {*model.names, *passed}
    first = {
        name: float(library.falls(name, views, residuals)[0][0])
        for name in library.columns
        if name not in done
    }
    order = sorted(first, key=lambda n: -first[n])[: options.searched]
    names = [
        n for i, n in enumerate(order) if i < options.contenders or first[n] > options.near * first[order[0]]
    ]
    found = [one for name in names if (one := best_of(scene, name, *views)) is not None]
    found += [search(scene, start, *views) for name, start in extra.items() if name not in done]
    return sorted(found, key=lambda f: -f.scored)


def _fitted(model: Model, found: Sequence[Found], material: Material) -> list[tuple[str, Model]]:
    """Full fits of some, each with what was named before."""
    if len(found) == 1:
        return [(found[0].effect, extended(model, found[0], material))]
    tasks = [(model, f, material.alone) for f in found]
    return [(f.effect, m) for f, m in zip(found, material.options.mapper(_extended, tasks), strict=True)]


def _extended(task: tuple[Model, Found, Material]) -> Model:
    return extended(*task)
