"""The joint fit: pose, E, S, rest, contact law and effects, with every press's own numbers integrated out.

Gauss-Newton on the whitened, robust residual; after each step of the whole presses go on by steps of their own numbers,
so that the next linearisation is about where they are. What a press would gain by itself is not taken in the step of
the whole: many go too far by it, and the whole would stop short.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from skincal.effects import effect
from skincal.inference.blocks import Blocks, Rows, Whitened, blocks
from skincal.inference.columns import Free, free_columns, with_values
from skincal.inference.constants import CONSTANTS as C
from skincal.inference.forward import BASE, LAW, Forward, Seen, State, moved_pose
from skincal.inference.score import held_out
from skincal.inference.slopes import Slopes
from skincal.model.arrays import BoolArray, FloatArray, IntArray

NB = len(BASE) + len(LAW)
_DAMPING, _REACH = 0.01, np.array([4e-4, 4e-4, 0.03])
"""Of the first step of a press by itself, and how far one may lead: metres, and the logarithm of its force."""
_FORM, _STRENGTH = 0.5, 0.4
"""A step of an effect's number is no longer than this part of what is expected of it beforehand."""
_LAW = np.array([[-3.0, 0.0], [-3.0, 3.0], [-3.0, 3.0], [0.0, 1 / C.law_bare]])
"""The law's numbers are no farther from the foundation than so many standard deviations of what is known of them.
A layer is never stiffer under a larger contact: a power above 1 is a material that stiffens. Bare is a part of one."""
_MOST = np.array([1.5e-3, 1.5e-3, 0.12, 0.35, 0.35, 5.0])
"""A step of the base is no longer than this: metres, metres, radians, logarithms; of rest in noises."""


@dataclass(frozen=True, eq=False)
class Beforehand:
    """What is known before the fit.

    Attributes:
        base: (6,) precision of the base's numbers about their start (place, angle, logarithms, rest).
        start: the state that the precisions are about.
        move: (3,) precision of a press's shift across and along [1/m²] and of the logarithm of its force.
        slack_m: most that a contact may be off.
        weights: (N, J) roots of robust weights, found once with the base model; 1 where nothing is wild.
        image: relative error of a press's image, taxel by taxel.
        errs: whether equations of effects may err.
    """

    base: FloatArray
    start: State
    move: FloatArray
    slack_m: float
    weights: FloatArray
    image: float = C.image
    errs: bool = True


@dataclass(frozen=True, eq=False)
class Fitted:
    """A state with its linearisation.

    Attributes:
        seen: the state and what it reads.
        free: numbers of effects that are fitted.
        blocks: of base, law and free columns, and of what the equations of effects may err by in all presses alike.
        prior: (n,) precisions of the columns.
        pull: (n,) slope of the prior at the state: precision times how far it is from its middle.
    """

    seen: Seen
    free: tuple[Free, ...]
    blocks: Blocks
    prior: FloatArray
    pull: FloatArray

    @property
    def state(self) -> State:
        """Where it stands."""
        return self.seen.state

    @property
    def numbers(self) -> int:
        """How many columns are numbers of the state: base, law and free ones. Errors of equations follow."""
        return NB + len(self.free)

    @property
    def covariance(self) -> FloatArray:
        """(n, n) mean squares of base, law and effects about the state, everything else integrated out.

        The state is that with equations at their word. Where they may err the posterior is wider, and lies elsewhere.
        """
        h, g, n = (
            self.blocks.h.sum(axis=0) + np.diag(self.prior),
            self.blocks.b.sum(axis=0) - self.pull,
            self.numbers,
        )
        wide = np.linalg.inv(h)[:n]
        aside = wide @ g - np.linalg.solve(h[:n, :n], g[:n])
        return wide[:, :n] + np.outer(aside, aside)

    def loss(self) -> float:
        """Minus twice the logarithm of the posterior, but for a constant."""
        return float(self.blocks.loss.sum() + (self.pull**2 / np.maximum(self.prior, 1e-300)).sum())

    def promised(self, step: FloatArray) -> float:
        """What a step of base, law and free numbers gains by the slopes [twice nats]."""
        h, b = self.blocks.h.sum(axis=0) + np.diag(self.prior), self.blocks.b.sum(axis=0) - self.pull
        return float(2 * b @ step - step @ h @ step)

    def predicted(self, folds: IntArray) -> FloatArray:
        """(B,) logarithm of the likelihood of each block by the fit of the other folds.

        A fit may end where its slopes still promise a gain, as the model bends: steps there were tried, and gained
        nothing. So it counts as the best of the line through it, or one that has stopped short would seem to predict
        better.
        """
        n, own = len(self.prior), slice(self.numbers)
        h, b, step = self.blocks.h[:, :n, :n], self.blocks.b[:, :n], np.zeros(n)
        whole = h.sum(axis=0) + np.diag(self.prior)
        step[own] = np.linalg.solve(whole[own, own], (b.sum(axis=0) - self.pull)[own])
        gained = held_out(h, (b - h @ step)[:, :, None], self.prior, self.pull + self.prior * step, folds)
        return gained[:, 0] - 0.5 * self.blocks.loss

    def chi(self) -> FloatArray:
        """(B,) squares that are left where equations err as is best."""
        b, n = self.blocks, self.numbers
        c = np.linalg.solve(b.h[:, n:, n:].sum(axis=0) + np.diag(self.prior[n:]), b.b[:, n:].sum(axis=0))
        return b.chi - 2 * b.b[:, n:] @ c + np.einsum("n,pnm,m->p", c, b.h[:, n:, n:], c)


class Settled(NamedTuple):
    """A state whose presses have gone on by themselves.

    Attributes:
        state: it.
        seen: what it reads.
        loss: (P + 1,) of presses, and of what is of no press.
    """

    state: State
    seen: Seen
    loss: FloatArray


class Fitter:
    """Fits one session."""

    def __init__(self, forward: Forward, counts: FloatArray, before: Beforehand) -> None:
        """Take the model, what was observed (N, J), and what is known beforehand."""
        self.forward, self.counts, self.before = forward, counts, before
        self.foundation = False
        """Whether the contact is held at the foundation's, as at the beginning of a search."""
        self._columns: tuple[tuple[Seen, tuple[Free, ...], bool], Slopes] | None = None
        s = forward.session
        self.press, self.phase, self.frames = s.press, s.phase, s.frames
        force = np.where(s.press >= 0, forward.mean @ np.nan_to_num(forward.samples.contacts.force_n), 0.0)
        self.force = np.maximum(force, 0.0)
        self._rows = Rows.of(s.press, s.phase, np.isfinite(counts))
        held = s.held()
        # All of a hold is at one level, with one error of rounding.
        self._alike = np.where(held, np.bincount(s.press[held], minlength=s.presses + 1)[s.press], 1.0)

    def __getstate__(self) -> dict[str, object]:
        """Return what another process needs."""
        return {**self.__dict__, "_columns": None}

    def whitened(self, seen: Seen, columns: Slopes | FloatArray, own: FloatArray) -> Whitened:
        """Over the noise.

        Args:
            seen: the state.
            columns: slopes by what is fitted, (K, J, n) if all of them are dense.
            own: (K, J, k) errors that equations of effects in the model may have.
        """
        f, noise = self.forward, self.forward.noise
        moves = f.press_columns(seen)
        expected, slope, variance = self.expected(seen, moves)
        if noise.force_n:
            by_force = f.mean @ (slope * moves[..., 2])
            per_n = by_force / np.maximum(self.force, 5 * noise.force_n)[:, None]
            variance = variance + (per_n * noise.force_n) ** 2 / self.frames[:, None]
        sd = np.sqrt(variance)
        ok = np.isfinite(self.counts)
        weight = np.where(ok, self.before.weights, 0.0) / sd

        def thin(x: FloatArray) -> FloatArray:
            """Means over observations, through the converter, over the noise."""
            return (f.mean @ (slope[..., None] * x)) * weight[..., None]

        residual = np.where(ok, self.counts - expected, 0.0) * weight
        signal = (f.mean @ (slope * seen.values)) * weight
        slopes = columns if isinstance(columns, Slopes) else Slopes.of(columns)
        thinned = slopes.through(f.mean.__matmul__, slope, weight)
        return Whitened(residual, thinned, thin(moves), signal, thin(own), ok, np.log(sd))

    def expected(
        self, seen: Seen, moves: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """What a state reads on average (N, J), slopes of the converter (K, J), and variance (N, J).

        ``moves`` (K, J, 3) is what a press's own numbers do to levels, if it is there already.
        """
        f, noise = self.forward, self.forward.noise
        level, spread = seen.values + seen.state.rest, None
        if noise.coarse:
            spread = self.spread(seen, f.press_columns(seen) if moves is None else moves)
        mean, slope, each, shared = noise.moments(level, spread)
        variance = (f.mean @ each + (noise.sigma**2 - noise.frame**2)) / self.frames[:, None]
        return f.mean @ mean, slope, variance + (f.mean @ shared) * self._alike[:, None]

    def spread(self, seen: Seen, moves: FloatArray) -> FloatArray:
        """(K, J) within what levels are known beforehand, by what a press's own numbers do to them (K, J, 3)."""
        return np.sqrt((moves**2) @ (1 / self.before.move) + (self.before.image * seen.values) ** 2)

    def columns(self, seen: Seen, free: tuple[Free, ...]) -> Slopes:
        """Slopes (K, J, n) of base, law and effects; those of the last state are kept."""
        f, key = self.forward, (seen, free, self.foundation)
        if self._columns is None or self._columns[0] != key:
            base = Slopes.of(f.base_columns(seen, contact=not self.foundation))
            self._columns = key, Slopes.joined([base, *free_columns(f, seen, free)])
        return self._columns[1]

    def equations(self, seen: Seen, *, word: bool = False) -> tuple[FloatArray, FloatArray]:
        """What the equations of effects in the model may err by, at one standard deviation.

        Returns:
            (K, J, k) of each effect, in each phase of a press for itself; (K, J, m) of all presses alike: in each
            phase, and in another proportion to the force, to what a taxel reads, and over the session; at their word
            none.
        """
        sized = [(effect(n).equation_error, n) for n in seen.state.effects]
        parts = [error * self.done_by(seen, n) for error, n in sized if error and self.before.errs]
        if not parts:
            none = np.zeros((*seen.values.shape, 0))
            return none, none
        own = np.stack(parts, axis=-1)
        if word:
            return own, own[..., :0]
        return own, np.concatenate([own * x[..., None] for x in self.manners(seen)], axis=2)

    def done_by(self, seen: Seen, name: str) -> FloatArray:
        """(K, J) what an effect in the model does to values."""
        without = {n: v for n, v in seen.state.effects.items() if n != name}
        return seen.values - self.forward.with_effects(seen, without)

    def manners(self, seen: Seen) -> list[FloatArray]:
        """Factors (K, 1) or (K, J) by which all presses alike may be off, at one standard deviation.

        In each phase, and in another proportion to the force, to what a taxel reads, and over the session.
        """
        samples = self.forward.samples
        force = np.nan_to_num(samples.contacts.force_n) * samples.touching
        factors = [_about_none(force)[:, None], _about_none(seen.values)]
        factors.append(np.linspace(-1.0, 1.0, len(samples))[:, None])
        if samples.phase is not None:
            factors += [(samples.phase == p)[:, None].astype(np.float64) for p in np.unique(samples.phase)]
        return factors

    def linear(
        self, state: State, free: tuple[Free, ...], seen: Seen | None = None, *, word: bool = False
    ) -> Fitted:
        """A state with its linearisation."""
        seen = self.forward.see(state) if seen is None else seen
        return self.built(seen, free, *self.columns_of(seen, free, word=word))

    def columns_of(self, seen: Seen, free: tuple[Free, ...], *, word: bool = False) -> tuple[Whitened, int]:
        """All that is fitted, whitened, and how many of the columns are errors of equations, which come last."""
        own, shared = self.equations(seen, word=word)
        columns = Slopes.joined([self.columns(seen, free), Slopes.of(shared)])
        return self.whitened(seen, columns, own), shared.shape[2]

    def built(
        self, seen: Seen, free: tuple[Free, ...], w: Whitened, errors: int = 0, **more: object
    ) -> Fitted:
        """A linearisation of whitened columns; columns beyond those of the model have no prior."""
        state = seen.state
        found = self.blocks(w, state.move, **more)
        prior, pull = self.prior(state, free)
        return Fitted(seen, free, found, np.append(prior, np.ones(errors)), np.append(pull, np.zeros(errors)))

    def blocks(self, w: Whitened, at: FloatArray, **more: object) -> Blocks:
        """Blocks of whitened columns about where presses are (P, 3)."""
        return blocks(
            w, self._rows, at, self.before.move, image=self.before.image, **more  # type: ignore[arg-type]
        )  # fmt: skip

    def prior(self, state: State, free: tuple[Free, ...]) -> tuple[FloatArray, FloatArray]:
        """(n,) precisions beforehand, and their slope at a state."""
        prior = np.concatenate([self.before.base, 1 / law_widths() ** 2, [1 / f.sigma**2 for f in free]])
        off = np.concatenate([self.off(state), state.law, [f.get(state.effects) - f.middle for f in free]])
        return prior, prior * off

    def off(self, state: State) -> FloatArray:
        """(6,) how far the base is from its start: place, turn, angle, logarithms of E and S, rest."""
        a, b = state.pose, self.before.start.pose
        turn = (a.beta_rad - b.beta_rad) * self.turning_radius(state) + a.x_m - b.x_m
        s = np.mean(state.log_s) - np.mean(self.before.start.log_s)
        e, rest = state.log_e - self.before.start.log_e, state.rest - self.before.start.rest
        return np.array([a.y_m - b.y_m, turn, a.alpha_rad - b.alpha_rad, e, s, rest])

    def turning_radius(self, state: State) -> float:
        """Distance of the patch from the axis that it is turned about [m]; 0 on a plane."""
        return self.forward.surface.arc_radius_at(state.pose) or 0.0

    def step(self, at: Fitted) -> FloatArray:
        """(n,) a Gauss-Newton step of base, law and free numbers from a linearisation with equations at their word."""
        b, s = at.blocks, at.state
        h, g = b.h.sum(axis=0) + np.diag(at.prior), b.b.sum(axis=0) - at.pull
        size = 1 / np.sqrt(np.diag(h))
        h, g = h * np.outer(size, size), g * size
        # No farther than the prior is wide, or the bounds let it; the others then go where that leaves them.
        reach = [f.sigma * (_FORM if f.parameter.role == "form" else _STRENGTH) for f in at.free]
        reach = np.array([*law_widths(), *reach])
        ends = np.array([*law_bounds(), *(f.bounds() for f in at.free)]).T
        ends = np.clip(ends - np.array([*s.law, *(f.get(s.effects) for f in at.free)]), -reach, reach)
        low, high = (
            np.append(np.full(len(BASE), side), x) for side, x in zip((-np.inf, np.inf), ends, strict=True)
        )
        d, held = np.zeros(len(g)), np.zeros(len(g), dtype=bool)
        while True:
            some = ~held
            d[some] = np.linalg.solve(h[np.ix_(some, some)], g[some] - h[np.ix_(some, held)] @ d[held])
            beyond = some & ((d * size < low) | (d * size > high))
            if not beyond.any():
                return self._short(d * size)
            held |= beyond
            d = np.clip(d, low / size, high / size)

    def _short(self, d: FloatArray) -> FloatArray:
        """A step (n,) no farther in the base than one may lead."""
        limit = _MOST * np.array([1, 1, 1, 1, 1, self.forward.noise.frame])
        return np.append(np.clip(d[: len(limit)], -limit, limit), d[len(limit) :])

    def moved(self, at: Fitted, d: FloatArray, columns: IntArray | None = None) -> State:
        """A state by so much of its columns, no farther than a step may lead; presses follow.

        Args:
            at: the linearisation.
            d: steps of base, law and free numbers; with columns, of these.
            columns: of the blocks that the steps belong to, those of the model first; None: the first ones.
        """
        b, s = at.blocks, at.state
        own, rest = self._short(d[: len(at.prior)]), (np.arange(len(d)) if columns is None else columns)
        pose = moved_pose(self.forward.surface, s.pose, "y", own[0])
        pose = moved_pose(self.forward.surface, pose, "turn", own[1])
        pose = moved_pose(self.forward.surface, pose, "alpha", own[2])
        law = np.clip(s.law + own[6:NB], *law_bounds().T)
        effects = (
            with_values(
                s.effects, at.free, np.array([f.get(s.effects) for f in at.free]) + own[NB : at.numbers]
            )
            if at.free
            else s.effects
        )
        move = -b.moves[:, :, rest] @ np.append(own, d[len(own) :])
        move = s.move + np.clip(move, -2 * _REACH, 2 * _REACH)
        move[:, :2] = np.clip(move[:, :2], -self.before.slack_m, self.before.slack_m)
        return replace(
            s,
            pose=pose,
            log_e=s.log_e + own[3],
            log_s=s.log_s + own[4],
            rest=s.rest + own[5],
            law=law,
            move=move,
            effects=effects,
        )

    def solve(self, state: State, free: tuple[Free, ...] = (), steps: int = 4) -> Fitted:
        """Fits, from a state, with equations at their word; of a step that makes it worse a part is taken."""
        at = self.linear(state, free, word=True)
        for _ in range(steps):
            d = self.step(at)
            if at.promised(d) < C.settled:
                break
            for part in (1.0, 0.3, 0.1):
                new, seen, total = self._careful(at, part * d)
                if total < at.loss() + C.loose:
                    break
            else:
                break
            gained = at.loss() - total
            at = self.linear(new, free, seen, word=True)
            if gained < C.settled:
                break
        return self.linear(at.state, free, at.seen) if at.state.effects else at

    def _careful(self, at: Fitted, d: FloatArray) -> tuple[State, Seen, float]:
        """The state that a step leads to, each press gone on from there by steps of its own, and its loss."""
        state, seen, loss = self.settled(self.moved(at, d))
        prior, pull = self.prior(state, at.free)
        return state, seen, float(loss.sum() + (pull**2 / np.maximum(prior, 1e-300)).sum())

    def settled(self, state: State, steps: int = C.own_steps, rows: IntArray | None = None) -> Settled:
        """A state with each press, or those of some rows, gone on by steps of its own.

        Levenberg's, each press with its own damping: a place is sharply told in one direction, and hardly in another.
        """
        every = np.arange(len(state.move))
        some = np.isin(every, every if rows is None else rows)
        seen, found = self.left(state)
        best = _of_presses(found, found.loss, len(state.move))
        owner, damping, ways = found.press, np.full(len(state.move), _DAMPING), [x.copy() for x in found.own]
        ahead = _of_presses(found, found.ahead, len(state.move))
        for _ in range(steps):
            # Where a press has nothing to gain it stays, and its table with it.
            if not (going := some & (ahead[:-1] > C.loose)).any():
                break
            new = replace(state, move=self._own_move(state.move, ways, owner, damping, going))
            seen, found = self.left(new)
            loss, ahead_now = (_of_presses(found, x, len(state.move)) for x in (found.loss, found.ahead))
            better = loss < best
            damping *= np.where(better[:-1], 0.2, 6.0)
            ways[0][better[owner]], ways[1][better[owner]] = (x[better[owner]] for x in found.own)
            state = replace(state, move=np.where(better[:-1, None], new.move, state.move))
            best, ahead = np.minimum(best, loss), np.where(better, ahead_now, ahead)
        if not (state.move == seen.state.move).all():
            seen = self.forward.see(state)
        return Settled(seen.state, seen, best)

    def _own_move(
        self,
        move: FloatArray,
        ways: Sequence[FloatArray],
        owner: IntArray,
        damping: FloatArray,
        going: BoolArray,
    ) -> FloatArray:
        """Own numbers (P, 3) after a step of those presses that go, by curvature and slope, no farther than one may."""
        own, (h, g) = (owner >= 0) & going[np.maximum(owner, 0)], ways
        p, three = owner[own], np.arange(-3, 0)
        h = h[own]
        h[:, three, three] *= 1 + damping[p, None]
        step = np.linalg.solve(h, g[own][..., None])[:, -3:, 0]
        move = move.copy()
        move[p] += step / np.maximum(1.0, np.abs(step / _REACH).max(axis=1))[:, None]
        move[:, :2] = np.clip(move[:, :2], -self.before.slack_m, self.before.slack_m)
        return move

    def left(self, state: State) -> tuple[Seen, Blocks]:
        """What a state reads, and what it leaves."""
        seen = self.forward.see(state)
        own, none = self.equations(seen, word=True)
        return seen, self.blocks(self.whitened(seen, none, own), state.move)


def law_widths() -> FloatArray:
    """(4,) how far the contact law is from a foundation's beforehand, in the numbers of a state."""
    return np.array([C.law_power, C.law_blur, C.law_radius, C.law_bare])


def law_bounds() -> FloatArray:
    """(4, 2) the least and the most that they are."""
    return law_widths()[:, None] * _LAW


def _of_presses(blocks: Blocks, values: FloatArray, presses: int) -> FloatArray:
    """(P + 1,) values of blocks by press, 0 of one that has none, and behind them what is of no press."""
    owner = np.where(blocks.press >= 0, blocks.press, presses)
    return np.bincount(owner, values, presses + 1).astype(np.float64)


def _about_none(x: FloatArray) -> FloatArray:
    """Numbers from 0 to their greatest as -1 to 1."""
    return 2 * x / max(float(x.max(initial=0.0)), 1e-12) - 1
