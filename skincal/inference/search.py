"""The one search: which effects a session shows.

::

    fit the base model; draw null sessions about it
    repeat
        columns of every effect that is not in the model, from each of its starts
        gain of each on presses that its fit has not seen
        of those beyond their null limit: fit the best few jointly with the base
        those that surely gain; the best and what is not told from it are fitted until they are settled
        take the one whose fit predicts best; those that predict as well are its set
        drop what the new one has made needless
    until none surely gains; the same from the next best of the set, and the better end is taken
    fit once more from where the sensor was thought to be, if the base has gone far from there

All gains are of :mod:`skincal.inference.score`, all limits of :mod:`skincal.inference.null`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from itertools import islice

import numpy as np

from skincal.effects import effect
from skincal.effects.samples import Samples
from skincal.effects.starts import Scene
from skincal.fitting.tasks import Mapper
from skincal.inference.blocks import Whitened
from skincal.inference.check import left
from skincal.inference.columns import Candidate, Free, begun, candidates, free_of, starts_of
from skincal.inference.constants import CONSTANTS as C
from skincal.inference.equation_errors import EquationErrors
from skincal.inference.fit import Fitted, Fitter, law_widths
from skincal.inference.forward import LAW, Effects, Seen, State
from skincal.inference.gains import full_step, gains, whole
from skincal.inference.null import FOUNDATION, Null, drawn_noise, law_residuals, parts_of_laws, with_laws
from skincal.inference.score import Score, folds_of
from skincal.inference.slopes import Slopes
from skincal.inference.start import Task, fitted
from skincal.model.arrays import FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class Tried:
    """A candidate in a round.

    Attributes:
        name: of the effect.
        gain: of its best start [nats].
        error: its standard error.
        sure: standard errors by which it is there.
        least: the null's limit, from which on it is worth a fit.
        limit: the same, or what equations of others may err by if that is more: what its fit must gain.
        p_value: part of null sessions that gain as much.
        candidate: the best start.
        coefficients: multiples of its points.
        shared: gain of which no press has more than a bounded part [nats].
        begin: where the base would go along with it.
    """

    name: str
    gain: float
    error: float
    sure: float
    least: float
    limit: float
    p_value: float
    candidate: Candidate
    coefficients: FloatArray
    shared: float
    begin: State

    @property
    def good(self) -> bool:
        """Whether it is worth a fit."""
        return self.gain > self.least and self.shared > 0


@dataclass(frozen=True, eq=False)
class Named:
    """An effect that was taken.

    Attributes:
        name: of it.
        alike: effects whose fit predicts as well, itself first.
        gain: that its fit adds [nats].
        limit: of the null.
        p_value: part of null sessions that reach its gain.
        rivals: fits of those alike, in its place.
    """

    name: str
    alike: tuple[str, ...]
    gain: float
    limit: float
    p_value: float
    rivals: tuple[tuple[str, Fitted], ...] = ()


@dataclass(frozen=True, eq=False)
class Path:
    """A way of the search: a set of effects, and what led to it.

    Attributes:
        fit: with its effects.
        named: in the order in which they were taken.
        rounds: what was tried in each round, best first.
        dropped: effects that another one has made needless.
        ended: whether nothing more surely gains.
    """

    fit: Fitted
    named: tuple[Named, ...] = ()
    rounds: tuple[tuple[Tried, ...], ...] = ()
    dropped: frozenset[str] = frozenset()
    ended: bool = False

    @property
    def effects(self) -> frozenset[str]:
        """Names of its effects."""
        return frozenset(n.name for n in self.named)


@dataclass(frozen=True, eq=False)
class Found:
    """What the search ends with.

    Attributes:
        base: the fit without effects.
        fitted: with what was named.
        named: in the order in which they were taken.
        rounds: what was tried in each round, best first.
        null: about the base model.
    """

    base: Fitted
    fitted: Fitted
    named: tuple[Named, ...]
    rounds: tuple[tuple[Tried, ...], ...]
    null: Null

    @property
    def left(self) -> FloatArray:
        """(3,) what the final model leaves (:func:`skincal.inference.check.left`)."""
        return left_by(self.fitted)

    @property
    def excess(self) -> FloatArray:
        """(3,) the same over what it may leave."""
        return (self.left - 1) / (self.null.left_limits() - 1)

    @property
    def open(self) -> bool:
        """Whether the final model leaves more than chance."""
        return bool((self.excess > 1).any())

    @property
    def doubtful(self) -> bool:
        """Whether what is named leaves more than chance, and more of what there was than an equation may err by."""
        before, after = np.maximum(left_by(self.base) - 1, C.noise), self.left - 1
        return bool(((after > C.equation * before) & (self.excess > 1)).any())


_ABLE = 1e-3
"""An effect can do what its slopes promise if it does so much of it."""


@dataclass(eq=False)
class Search:
    """A search at work."""

    fitter: Fitter
    base: Fitted
    names: Sequence[str]
    covariates: frozenset[str]
    rng: np.random.Generator
    heard: Callable[[str], None] = lambda _: None
    null_sessions: int = C.null_sessions
    mapper: Mapper = map
    _folds: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    _known: Effects = field(default_factory=dict)
    _less: dict[tuple[Fitted, str], Fitted] = field(default_factory=dict)
    _line: tuple[Fitted, tuple[list[Candidate], Whitened, int]] | None = None
    _null: Null = field(init=False)

    @cached_property
    def lined(self) -> Fitter:
        """The fitter that looks beyond a step: where counts are a staircase slopes about it say little of it."""
        if not self.fitter.forward.noise.coarse:
            return self.fitter
        forward = copy(self.fitter.forward)
        forward.noise = replace(forward.noise, stairs=forward.noise)
        return Fitter(forward, self.fitter.counts, self.fitter.before)

    def run(self) -> Found:
        """From the base model to what is missing."""
        self._folds = folds_of(self.base.blocks, self.rng)
        self._known, self._null = dict(self.base.state.effects), self._drawn()
        going, ended = [Path(self.base)], list[Path]()
        while going:
            grown = [one for path in going for one in self._grown(path)]
            ended += [path for path in grown if path.ended]
            # Two ways to the same names are one.
            by_names = {path.effects: path for path in sorted(grown, key=self._total) if not path.ended}
            going = sorted(by_names.values(), key=self._total, reverse=True)[: C.paths]
        best = self._chosen(ended)
        fit, named = best.fit, [self._told_apart(best, k, ended) for k in range(len(best.named))]
        for old in named[:-1]:
            fit, named = self._swapped(fit, named, old)
        fit = self._from_start(fit) if named else fit
        end = replace(best, fit=fit, named=tuple(named))
        if fit is not best.fit:
            # Elsewhere something else may be needless.
            end = self._needed(end, end.named)
        return Found(self.base, end.fit, end.named, best.rounds, self._null)

    def _grown(self, path: Path) -> list[Path]:
        """A path with one more effect: the one that predicts best, and each that is not told from it."""
        fit, named = path.fit, path.named
        tried = self._round(fit, named)
        rounds = (*path.rounds, tuple(tried))
        good = [t for t in tried if t.good and t.name not in path.dropped]
        more = len(named) < C.most and len(rounds) <= 2 * C.most
        alike = self._best(fit, good) if good and more else []
        if not alike:
            return [replace(path, rounds=rounds, ended=True)]
        more = [(new, _added(named, own)) for own, new in alike[: C.paths]]
        return [
            self._needed(replace(path, fit=new, named=names, rounds=rounds), names[:-1])
            for new, names in more
        ]

    def _needed(self, path: Path, asked: Sequence[Named]) -> Path:
        """The same path without those of some effects that are needless."""
        asked = self._perhaps_needless(path.fit, asked)
        for old, less in zip(asked, self._without(path.fit, [n.name for n in asked]), strict=True):
            if Score(self.score(path.fit) - self.score(less)).total < old.limit:
                left = self._worth(less, [n for n in path.named if n is not old])
                path = replace(path, fit=less, named=left, dropped=path.dropped | {old.name})
                names = [n.name for n in asked]
                return self._needed(path, [n for n in left if n.name in names])
        return path

    def _worth(self, fit: Fitted, named: Sequence[Named]) -> tuple[Named, ...]:
        """Effects with what they gain in a fit that another one has left."""
        lost = [self.score(fit) - self.score(x) for x in self._without(fit, [n.name for n in named])]
        return tuple(replace(n, gain=Score(x).total) for n, x in zip(named, lost, strict=True))

    def _perhaps_needless(self, fit: Fitted, asked: Sequence[Named]) -> list[Named]:
        """Of some effects those without which, after a few steps, not much of what they gained is lost."""
        rough = self._without(fit, [n.name for n in asked], few=True)
        lost = [Score(self.score(fit) - self.score(less)).total for less in rough]
        return [n for n, x in zip(asked, lost, strict=True) if x < C.contend * n.gain]

    def _total(self, path: Path) -> float:
        return float(self.score(path.fit).sum())

    def _chosen(self, ended: Sequence[Path]) -> Path:
        """The path that predicts best.

        One with more effects must gain what each of those more must, and what the other's effects that it does without
        may lose as their equations err.
        """
        best, *others = sorted(ended, key=lambda p: (len(p.named), -self._total(p)))
        for path in others:
            more = len(path.named) - len(best.named)
            least = sum(sorted(n.limit for n in path.named)[:more])
            least += sum(_lost(n.name, n.gain) for n in best.named if more and n.name not in path.effects)
            gain = Score(self.score(path.fit) - self.score(best.fit))
            if gain.total > least and (not more or gain.sure > C.alike):
                best = path
        return best

    def _told_apart(self, best: Path, k: int, ended: Sequence[Path]) -> Named:
        """An effect of the best path, without those alike whose own paths end at what surely predicts worse."""
        own, scores = best.named[k], self.score(best.fit)
        gone = set[str]()
        for path in ended:
            other = path.named[k].name if len(path.named) > k else own.name
            rival = other in own.alike and other != own.name and best.named[:k] == path.named[:k]
            if rival and not _near(Score(scores - self.score(path.fit)), other, own.gain):
                gone.add(other)
        left = tuple(n for n in own.alike if n not in gone)
        return replace(own, alike=left, rivals=tuple((n, x) for n, x in own.rivals if n not in gone))

    def _swapped(self, fit: Fitted, named: list[Named], old: Named) -> tuple[Fitted, list[Named]]:
        """An effect against all others that gain more than it does beside those that were found after it."""
        (less,) = self._without(fit, [old.name])
        others = [n for n in named if n is not old]
        tried = self._round(less, others)
        own = max((t.gain for t in tried if t.name == old.name), default=0.0)
        best = self._best(less, [t for t in tried if t.good and t.gain > own])
        if not best or best[0][0].name in [n.name for n in others]:
            return fit, named
        other, new = best[0]
        if Score(self.score(new) - self.score(fit)).total <= 0:
            return fit, named
        return new, [other if n is old else n for n in named]

    # ------------------------------------------------------------------ a round

    def _round(self, fit: Fitted, named: Sequence[Named]) -> list[Tried]:
        """What every effect that is not in the model would gain, best first."""
        found, w, shared = self._linear(fit)
        linear = self.lined.built(fit.seen, fit.free, w, shared)
        errors = EquationErrors.of(self.lined, fit, w)
        n = len(linear.prior)
        begin = n + np.cumsum([0, *(len(c.columns) for c in found)])
        alone = full_step(*whole(linear.blocks, np.arange(n)), linear.prior, linear.pull)
        best: dict[str, tuple[Score, int]] = {}
        for k, each in enumerate(self._gains(linear, found, linear.blocks.b[:, :, None], linear.pull)):
            s, name = Score(each[:, 0]), found[k].name
            if name not in best or s.total > best[name][0].total:
                best[name] = s, k
        out: list[Tried] = []
        for name, (s, k) in best.items():
            c = found[k]
            own = np.append(np.arange(n), np.arange(begin[k], begin[k + 1]))
            prior = np.append(linear.prior, 1 / np.array(c.start.sigma) ** 2)
            h, b = whole(linear.blocks, own)
            step = full_step(h, b, prior, np.append(linear.pull, np.zeros(len(c.columns))))
            way = np.zeros(len(w.columns))
            way[own] = step
            way[:n] -= alone
            bar = errors.owed(linear.blocks, way, float(way[own] @ h @ way[own])) if errors else 0.0
            least, p = self._null.limit(name), self._null.p_value(name, s.total)
            at = self.fitter.moved(linear, step, own)
            out.append(
                Tried(name, s.total, s.error, s.sure, least, max(least, bar), p, c, step[n:], s.shared, at)
            )
        return sorted(out, key=lambda t: -t.gain)

    def _linear(self, fit: Fitted) -> tuple[list[Candidate], Whitened, int]:
        """Candidates, the linearisation with their columns behind the model's, and how many of these are errors.

        That of the base model serves null sessions and the first round.
        """
        if self._line is not None and self._line[0] is fit:
            return self._line[1]
        seen, f = fit.seen, self.lined.forward
        slope = f.noise.written(seen.values + seen.state.rest)[1]
        alone = {x.effect for x in fit.free if x.index is not None}
        alone &= {n for n in seen.state.effects if any(s.alone is not None for s in starts_of(n, self.scene))}
        had: set[tuple[str, int | None]] = {(n, None) for n in seen.state.effects if n not in alone}
        had |= {(x.effect, x.index) for x in fit.free if x.index is not None}
        found = list(candidates(f, seen, self.scene, slope, self.names, had))
        w, errors = self.lined.columns_of(seen, fit.free)
        weight = np.where(w.seen, self.fitter.before.weights, 0.0) / np.exp(w.log_sd)
        columns = Slopes.joined([w.columns, *(c.columns.weighted(weight) for c in found)])
        self._line = fit, (found, replace(w, columns=columns), errors)
        return self._line[1]

    def _drawn(self) -> Null:
        """Null sessions about the base model."""
        self.heard("null sessions")
        base, fitter = self.base, self.lined
        found, w, errors = self._linear(base)
        laws = law_residuals(fitter, base, self.mapper)
        others = np.reshape([*laws.values()], (len(laws), *fitter.counts.shape))
        draws = drawn_noise(fitter, base, self.rng, self.null_sessions)
        w = replace(w, columns=Slopes.joined([w.columns, Slopes.of(np.moveaxis(others, 0, 2))]))
        linear = fitter.built(base.seen, base.free, w, errors, draws=draws, rng=self.rng)
        names = [FOUNDATION, *laws]
        turn = np.arange(self.null_sessions) % len(names)
        b, n = linear.blocks, len(linear.prior)
        sigma = np.array([x for c in found for x in c.start.sigma])
        parts = parts_of_laws(b, linear.prior, linear.pull, sigma, len(laws))[:, None]
        parts = parts * (turn == 1 + np.arange(len(laws))[:, None])
        drawn, drawn_chi = with_laws(b, parts)
        gained: dict[str, FloatArray] = {}
        for c, each in zip(found, self._gains(linear, found, drawn, np.zeros(n)), strict=True):
            own = each.sum(axis=0)
            gained[c.name] = np.maximum(gained[c.name], own) if c.name in gained else own
        if fitter is not self.fitter:
            # What a fit leaves of a staircase is compared with the same; beside that laws leave little.
            draws = drawn_noise(self.fitter, base, self.rng, self.null_sessions)
            w, errors = self.fitter.columns_of(base.seen, base.free)
            linear = self.fitter.built(base.seen, base.free, w, errors, draws=draws, rng=self.rng)
            drawn, drawn_chi = linear.blocks.drawn, linear.blocks.drawn_chi
        return Null(tuple(names[k] for k in turn), gained, _left_of_drawn(linear, drawn, drawn_chi))

    def _gains(
        self, linear: Fitted, found: Sequence[Candidate], b: FloatArray, pull: FloatArray
    ) -> list[FloatArray]:
        """(B, S) what blocks gain by each candidate."""
        sigma = [np.array(c.start.sigma) for c in found]
        return gains(linear.blocks, b, linear.prior, pull, sigma, self._folds)

    def _best(self, fit: Fitted, good: Sequence[Tried]) -> list[tuple[Named, Fitted]]:
        """Of the best few those whose joint fit surely predicts better: the best, and those that predict as well.

        What is near the best after a few steps is fitted until it is settled before it is compared: the base has gone
        along with what was missing, and may have far to come back.
        """
        scaled = cache(lambda t: self._scaled(fit, t))
        order = sorted(good, key=lambda t: -t.shared)
        most = next((t.gain for t in sorted(good, key=lambda t: -t.gain) if scaled(t)), 0.0)
        shared = next((t.shared for t in order if scaled(t)), 0.0)
        able = (
            (t, v)
            for t in order
            if t.shared > C.contend * shared or t.gain > C.contend * most
            if (v := scaled(t))
        )
        tried = list(islice(able, C.contenders))
        fits: list[tuple[Tried, Fitted]] = []
        for (t, _), new in zip(tried, self._joint(fit, tried), strict=True):
            gain = Score(self.score(new) - self.score(fit))
            # Many presses gain a little, or some gain much: a few alone are no evidence, whatever they gain.
            if gain.total > t.limit and (max(t.sure, gain.sure) > C.sure or gain.lasting > t.limit):
                fits.append((t, new))
        near = self._alike(fit, fits)
        ends = self._ends([(x.state, x.free) for _, x in near])
        fits = [(t, x) for (t, _), x in zip(near, ends, strict=True)]
        before = self.score(fit)
        fits = [(t, x) for t, x in fits if Score(self.score(x) - before).total > t.limit]
        fits = self._alike(fit, fits)
        names, out = [t.name for t, _ in fits], list[tuple[Named, Fitted]]()
        for t, x in fits:
            rivals = tuple((u.name, y) for u, y in fits if u is not t)
            alike = (t.name, *(n for n in names if n != t.name))
            out.append(
                (Named(t.name, alike, Score(self.score(x) - before).total, t.limit, t.p_value, rivals), x)
            )
        return out

    def _alike(self, fit: Fitted, fits: Sequence[tuple[Tried, Fitted]]) -> list[tuple[Tried, Fitted]]:
        """The one that predicts best, and those that are not surely worse.

        One is not if its difference is not sure, or no more than what its equation may err by makes it lose.
        """
        before, scores = self.score(fit), [self.score(x) for _, x in fits]
        best = max(scores, key=np.sum, default=before)
        near: list[tuple[float, int]] = []
        for i, ((tried, _), own) in enumerate(zip(fits, scores, strict=True)):
            behind = Score(best - own)
            if own is best or _near(behind, tried.name, Score(own - before).total):
                near.append((behind.total, i))
        return [fits[i] for _, i in sorted(near)]

    # ------------------------------------------------------------------ fits

    def score(self, fit: Fitted) -> FloatArray:
        """(B,) logarithm of the likelihood of each block by the fit of the others."""
        return fit.predicted(self._folds)

    def _joint(self, fit: Fitted, tried: Sequence[tuple[Tried, Mapping[str, FloatArray]]]) -> list[Fitted]:
        """The joint fits with one more each, after a few steps."""
        return list(self.mapper(fitted, [self._with_one(fit, t, values) for t, values in tried]))

    def _with_one(self, fit: Fitted, tried: Tried, values: Mapping[str, FloatArray]) -> Task:
        """The joint fit with one more, from values of its parameters."""
        more = free_of(tried.name, values, tried.candidate.start, self.covariates)
        had = {(f.effect, f.parameter.name, f.index) for f in fit.free}
        free = (*fit.free, *(f for f in more if (f.effect, f.parameter.name, f.index) not in had))
        values = self._from_onset(fit, tried, values)
        # The base stays where it is, or goes along as far as its slopes say: whichever is nearer. What shifts contacts
        # may have been followed by presses already: they then are where they were before.
        at = [replace(x, effects={**x.effects, tried.name: values}) for x in (fit.state, tried.begin)]
        back = self.fitter.forward.shifted(fit.state) - self.fitter.forward.shifted(at[0])
        if back.any():
            at.append(replace(at[0], move=fit.state.move + np.pad(back, ((0, 0), (0, 1)))))
        if _like_none(fit.state):
            # What is missing has bent the law as far as it goes, and the skin with it.
            ways = (0.0, *(side * much for much in C.softer for side in (1, -1)))
            at += [replace(at[0], law=np.zeros(len(LAW)), log_e=at[0].log_e + way) for way in ways]
        return Task(self.fitter, tuple(at), free, C.joint_steps)

    def _from_onset(
        self, fit: Fitted, tried: Tried, values: Mapping[str, FloatArray]
    ) -> Mapping[str, FloatArray]:
        """Values of an effect that acts from the press on which lets it and the fit without it leave least together."""
        name, alone, f = tried.name, tried.candidate.start.alone, self.fitter.forward
        onset = next((p.name for p in effect(name).parameters if p.role == "onset"), "")
        if onset not in values:
            return values

        def since(moment_s: float) -> dict[str, FloatArray]:
            at = np.array(values[onset])
            at[... if alone is None else alone] = moment_s
            return {**values, onset: at}

        ever = replace(fit.state, effects={**fit.state.effects, name: since(0.0)})
        more = (self.fitter.settled(ever).loss - self.fitter.settled(fit.state).loss)[:-1]
        begin = np.full(len(more), np.inf)
        np.minimum.at(begin, f.row[f.row >= 0], f.samples.elapsed_s[f.row >= 0])
        order = np.argsort(begin)[: int(np.isfinite(begin).sum())]
        first = int(np.argmin(np.cumsum(more[order][::-1])[::-1]))
        return since(float(begin[order[first]]) if first else 0.0)

    def _ends(self, begin: Sequence[tuple[State, tuple[Free, ...]]]) -> list[Fitted]:
        """Fits from states with numbers that are free, gone on to their ends."""
        tasks = [Task(self.fitter, (state,), free, to_end=True) for state, free in begin]
        return list(self.mapper(fitted, tasks))

    def _from_start(self, fit: Fitted) -> Fitted:
        """The fit, or one from where the sensor was thought to be, if it has gone far from there and that is better.

        A base that gave way to what was missing can end at another pose, with all presses moved, and stay there. Or it
        ends at a skin that is far too hard, under a law like none: then it begins at softer ones, too.
        """
        start, begin = self.fitter.before.start, list[float]()
        sd = np.sqrt(np.diag(fit.covariance)[:4])
        if (np.abs(self.fitter.off(fit.state)[:4]) >= C.alike * sd).any():
            begin.append(start.log_e)
        if _like_none(fit.state):
            begin += [fit.state.log_e - much for much in C.softer]
        anew = replace(fit.state, pose=start.pose, law=np.zeros(len(LAW)), move=start.move)
        return min([fit, *self._ends([(replace(anew, log_e=x), fit.free) for x in begin])], key=Fitted.loss)

    def _scaled(self, fit: Fitted, tried: Tried) -> dict[str, FloatArray] | None:
        """Parameters that do what the multiples of a start's points do to first order: few equations are lines.

        None where bounds let them do nothing of it: what is missing is the contrary of the effect.
        """
        f, c, before = self.lined.forward, tried.candidate, fit.state.effects.get(tried.name)
        wanted = c.columns.times(tried.coefficients)
        _, slope = f.noise.written(fit.seen.values + fit.state.rest)
        best: tuple[float, dict[str, FloatArray] | None] = (1 - _ABLE) * float((wanted**2).sum()), None
        for scale in C.scales:
            values = begun(tried.name, c.start, scale * tried.coefficients, before)
            does = f.mean @ (
                (f.with_effects(fit.seen, {**fit.state.effects, tried.name: values}) - fit.seen.values)
                * slope
            )
            off = float(((does - wanted) ** 2).sum())
            if off < best[0]:
                best = off, values
        return best[1]

    def _without(self, fit: Fitted, names: Sequence[str], *, few: bool = False) -> list[Fitted]:
        """The fits without each of some effects: to their ends, worked out once, or after a few steps."""
        new = names if few else [n for n in names if (fit, n) not in self._less]
        begin = list[tuple[State, tuple[Free, ...]]]()
        for name in new:
            effects = {n: v for n, v in fit.state.effects.items() if n != name or n in self._known}
            begin.append(
                (replace(fit.state, effects=effects), tuple(f for f in fit.free if f.effect != name))
            )
        if few:
            tasks = [Task(self.fitter, (state,), free, C.few_steps) for state, free in begin]
            return list(self.mapper(fitted, tasks))
        self._less.update({(fit, n): less for n, less in zip(new, self._ends(begin), strict=True)})
        return [self._less[fit, n] for n in names]

    @property
    def scene(self) -> Scene:
        """The scale of the session."""
        return scene_of(self.fitter, self.base)


def _like_none(state: State) -> bool:
    """Whether a state's contact law is none that a layer has."""
    return bool((np.abs(state.law) > C.like_none * law_widths()).any())


def _near(behind: Score, name: str, gained: float) -> bool:
    """Whether an effect that gains so much is not surely behind, or by no more than its equation may make it lose."""
    return behind.total < max(C.alike * max(behind.error, 1.0), _lost(name, gained))


def _lost(name: str, gained: float) -> float:
    """What an effect that gains so much may lose as its equation errs [nats]."""
    return 0.5 * effect(name).equation_error ** 2 * gained


def _added(named: tuple[Named, ...], own: Named) -> tuple[Named, ...]:
    """Effects with one more; one that is found again, for other taxels, gains that much more."""
    again = next((n for n in named if n.name == own.name), None)
    if again is None:
        return (*named, own)
    return tuple(replace(n, gain=n.gain + own.gain) if n is again else n for n in named)


def _left_of_drawn(linear: Fitted, drawn: FloatArray, drawn_chi: FloatArray) -> FloatArray:
    """(S, 3) what the base model leaves of simulated sessions, its own fit's part taken up there as in the data."""
    b, n = linear.blocks, len(linear.prior)
    h = b.products.between(np.arange(n), np.arange(n))
    c = np.linalg.solve(h.sum(axis=0) + np.diag(linear.prior), drawn[:, :n].sum(axis=0))
    chi = drawn_chi - 2 * np.einsum("pns,ns->ps", drawn[:, :n], c) + np.einsum("ns,pns->ps", c, h @ c)
    return left(chi, b.count, b.press)


def left_by(fit: Fitted) -> FloatArray:
    """(3,) what a fit leaves where equations err as is best."""
    return left(fit.chi()[:, None], fit.blocks.count, fit.blocks.press)[0]


def top_of(seen: Seen, samples: Samples) -> float:
    """A large value above rest [counts]."""
    on = samples.touching
    return max(float(np.quantile(seen.values[on].max(axis=1), 0.95)), 1e-12) if on.any() else 1.0


def scene_of(fitter: Fitter, base: Fitted) -> Scene:
    """The scale of a session, by the base model's fit."""
    s, seen = fitter.forward.samples, base.seen
    on = s.touching
    load = float(np.quantile(seen.loads[on].max(axis=1), 0.95)) if on.any() else 1.0
    span = float(s.elapsed_s.max(initial=0.0))
    speed = s.speed_m_per_s
    return Scene(
        taxels=seen.values.shape[1],
        poses=1 if s.pose is None else int(s.pose.max(initial=0)) + 1,
        top_counts=top_of(seen, s),
        top_n=max(load, 1e-9),
        force_n=float(np.median(s.contacts.force_n[on])) if on.any() else 1.0,
        duration_s=max(span, 1.0),
        speed_m_per_s=1e-3 if speed is None or not np.isfinite(speed).any() else float(np.nanmedian(speed)),
    )
