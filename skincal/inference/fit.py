"""The joint fit of pose, E, S, rest, contact law and effects; nuisance parameters of presses are integrated out.

Gauss-Newton on the whitened, robust residual. After each step of the shared parameters the nuisance parameters of every
press take steps of their own, so that the next linearisation is about where the presses are. Both are alternated: a
joint step takes many presses too far, and the shared parameters would stop short.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from skincal.effects import effect
from skincal.inference.blocks import Blocks, Rows, Whitened, blocks
from skincal.inference.columns import FreeParameter, free_columns, with_values
from skincal.inference.constants import CONSTANTS as C
from skincal.inference.forward import BASE, LAW, Forward, State, StatePrediction, moved_pose
from skincal.inference.score import held_out
from skincal.inference.slopes import Slopes
from skincal.model.arrays import BoolArray, FloatArray, IntArray

NB = len(BASE) + len(LAW)
_DAMPING, _REACH = 0.01, np.array([4e-4, 4e-4, 0.03])
"""Damping of the first step of a press, and the largest step: metres, and the logarithm of its force."""
_FORM, _STRENGTH = 0.5, 0.4
"""Largest step of forms and strengths of effects, in prior standard deviations."""
_LAW = np.array([[-3.0, 0.0], [-3.0, 3.0], [-3.0, 3.0], [0.0, 1 / C.law_bare]])
"""Bounds of the law's parameters, in prior standard deviations. The power is at most 1: a layer does not stiffen under
a larger contact, only a material does. Bare is a part of one."""
_MOST = np.array([1.5e-3, 1.5e-3, 0.12, 0.35, 0.35, 5.0])
"""Largest step of the base: metres, metres, radians, logarithms, and rest in units of the noise."""


@dataclass(frozen=True, eq=False)
class Priors:
    """Prior knowledge of a fit.

    Attributes:
        base: (6,) precisions of the base parameters about their start (place, angle, logarithms, rest).
        start: state that the precisions are about.
        move: (3,) precisions of the shift of a press across and along [1/m²] and of the logarithm of its force.
        slack_m: largest shift of a contact.
        weights: (N, J) square roots of robust weights, from the fit of the base model; 1 without outliers.
        image: relative error of the image of a press, independent in each taxel.
        errs: True if equations of effects may have errors.
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
        prediction: the state and its prediction.
        free: fitted numbers of effects.
        blocks: normal equations of base, law and free columns, and of equation errors that all presses share.
        prior: (n,) precisions of the columns.
        pull: (n,) slope of the prior at the state: precision times the distance from its mean.
    """

    prediction: StatePrediction
    free: tuple[FreeParameter, ...]
    blocks: Blocks
    prior: FloatArray
    pull: FloatArray

    @property
    def state(self) -> State:
        """The state."""
        return self.prediction.state

    @property
    def numbers(self) -> int:
        """Number of columns of base, law and free parameters; those of equation errors follow."""
        return NB + len(self.free)

    @property
    def covariance(self) -> FloatArray:
        """Covariance (n, n) of base, law and effects, everything else integrated out.

        The state is the fit without equation errors. With them the posterior is wider and its mean lies elsewhere; the
        square of that distance is added.
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
        """Return minus twice the log posterior, up to a constant."""
        return float(self.blocks.loss.sum() + (self.pull**2 / np.maximum(self.prior, 1e-300)).sum())

    def linear_gain(self, step: FloatArray) -> float:
        """Return the linear estimate of what a step of base, law and free parameters gains [twice nats]."""
        h, b = self.blocks.h.sum(axis=0) + np.diag(self.prior), self.blocks.b.sum(axis=0) - self.pull
        return float(2 * b @ step - step @ h @ step)

    def held_out_scores(self, folds: IntArray) -> FloatArray:
        """Return the held-out log-likelihood (B,) of each block, under the parameters fitted to the other folds.

        A fit may stop where its slopes still promise a gain, because the model bends and the steps failed. It is
        therefore scored as if it were the optimum of its linearisation; otherwise an early stop would look like a
        better prediction.
        """
        n, own = len(self.prior), slice(self.numbers)
        h, b, step = self.blocks.h[:, :n, :n], self.blocks.b[:, :n], np.zeros(n)
        whole = h.sum(axis=0) + np.diag(self.prior)
        step[own] = np.linalg.solve(whole[own, own], (b.sum(axis=0) - self.pull)[own])
        gained = held_out(h, (b - h @ step)[:, :, None], self.prior, self.pull + self.prior * step, folds)
        return gained[:, 0] - 0.5 * self.blocks.loss

    def chi(self) -> FloatArray:
        """Return squared residuals (B,) with equation errors at their best values."""
        b, n = self.blocks, self.numbers
        c = np.linalg.solve(b.h[:, n:, n:].sum(axis=0) + np.diag(self.prior[n:]), b.b[:, n:].sum(axis=0))
        return b.chi - 2 * b.b[:, n:] @ c + np.einsum("n,pnm,m->p", c, b.h[:, n:, n:], c)


class ProfiledState(NamedTuple):
    """A state whose presses have moved to their best places.

    Attributes:
        state: with the moves of the presses.
        prediction: its prediction.
        loss: (P + 1,) loss of presses, and of what belongs to no press.
    """

    state: State
    prediction: StatePrediction
    loss: FloatArray


class Fitter:
    """Fits one session."""

    def __init__(self, forward: Forward, counts: FloatArray, priors: Priors) -> None:
        """Take the model, the observed means (N, J) and the prior knowledge."""
        self.forward, self.counts, self.priors = forward, counts, priors
        self.foundation = False
        """True to hold the contact law at the foundation's, as at the beginning of a search."""
        self._columns: tuple[tuple[StatePrediction, tuple[FreeParameter, ...], bool], Slopes] | None = None
        s = forward.session
        self.press, self.phase, self.frames = s.press, s.phase, s.frames
        force = np.where(s.press >= 0, forward.mean @ np.nan_to_num(forward.samples.contacts.force_n), 0.0)
        self.force = np.maximum(force, 0.0)
        self._rows = Rows.of(s.press, s.phase, np.isfinite(counts))
        held = s.held()
        # All frames of a hold are at one level and share one rounding error.
        self._alike = np.where(held, np.bincount(s.press[held], minlength=s.presses + 1)[s.press], 1.0)

    def __getstate__(self) -> dict[str, object]:
        """Return what another process needs."""
        return {**self.__dict__, "_columns": None}

    def whitened(
        self, prediction: StatePrediction, columns: Slopes | FloatArray, own: FloatArray
    ) -> Whitened:
        """Divide residual and slopes by the noise, with robust weights.

        Args:
            prediction: state and its prediction.
            columns: slopes by the parameters, or all of them dense (K, J, n).
            own: (K, J, k) equation errors of the effects in the model.
        """
        f, noise = self.forward, self.forward.noise
        moves = f.press_columns(prediction)
        expected, slope, variance = self.expected(prediction, moves)
        if noise.force_n:
            by_force = f.mean @ (slope * moves[..., 2])
            per_n = by_force / np.maximum(self.force, 5 * noise.force_n)[:, None]
            variance = variance + (per_n * noise.force_n) ** 2 / self.frames[:, None]
        sd = np.sqrt(variance)
        ok = np.isfinite(self.counts)
        weight = np.where(ok, self.priors.weights, 0.0) / sd

        def thin(x: FloatArray) -> FloatArray:
            """Means over observations, through the converter, over the noise."""
            return (f.mean @ (slope[..., None] * x)) * weight[..., None]

        residual = np.where(ok, self.counts - expected, 0.0) * weight
        signal = (f.mean @ (slope * prediction.values)) * weight
        slopes = columns if isinstance(columns, Slopes) else Slopes.of(columns)
        thinned = slopes.through(f.mean.__matmul__, slope, weight)
        return Whitened(residual, thinned, thin(moves), signal, thin(own), ok, np.log(sd))

    def expected(
        self, prediction: StatePrediction, moves: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Compute the expected means (N, J) of a state, slopes of the converter (K, J), and variances (N, J).

        ``moves`` (K, J, 3) are the slopes of levels by the nuisance parameters of presses, if they are known already.
        """
        f, noise = self.forward, self.forward.noise
        level, spread = prediction.values + prediction.state.rest, None
        if noise.coarse:
            spread = self.level_sd(prediction, f.press_columns(prediction) if moves is None else moves)
        mean, slope, each, shared = noise.moments(level, spread)
        variance = (f.mean @ each + (noise.sigma**2 - noise.frame**2)) / self.frames[:, None]
        return f.mean @ mean, slope, variance + (f.mean @ shared) * self._alike[:, None]

    def level_sd(self, prediction: StatePrediction, moves: FloatArray) -> FloatArray:
        """Return the prior standard deviation (K, J) of levels, by the slopes (K, J, 3) of the nuisance parameters."""
        return np.sqrt((moves**2) @ (1 / self.priors.move) + (self.priors.image * prediction.values) ** 2)

    def columns(self, prediction: StatePrediction, free: tuple[FreeParameter, ...]) -> Slopes:
        """Return slopes (K, J, n) by base, law and effects; the last ones are cached."""
        f, key = self.forward, (prediction, free, self.foundation)
        if self._columns is None or self._columns[0] != key:
            base = Slopes.of(f.base_columns(prediction, contact=not self.foundation))
            self._columns = key, Slopes.joined([base, *free_columns(f, prediction, free)])
        return self._columns[1]

    def equation_errors(
        self, prediction: StatePrediction, *, word: bool = False
    ) -> tuple[FloatArray, FloatArray]:
        """Return the equation errors of the effects in the model, one standard deviation each.

        Returns:
            (K, J, k) error of each effect, independent in each phase of a press; (K, J, m) errors that all presses
            share: one factor in each phase, and factors that vary with force, with the reading of a taxel and over the
            session. Errors are left out of the second with ``word`` (equations are taken at their word).
        """
        sized = [(effect(n).equation_error, n) for n in prediction.state.effects]
        parts = [
            error * self.effect_values(prediction, n) for error, n in sized if error and self.priors.errs
        ]
        if not parts:
            none = np.zeros((*prediction.values.shape, 0))
            return none, none
        own = np.stack(parts, axis=-1)
        if word:
            return own, own[..., :0]
        return own, np.concatenate([own * x[..., None] for x in self.shared_error_modes(prediction)], axis=2)

    def effect_values(self, prediction: StatePrediction, name: str) -> FloatArray:
        """Return the change (K, J) of values by an effect in the model."""
        without = {n: v for n, v in prediction.state.effects.items() if n != name}
        return prediction.values - self.forward.with_effects(prediction, without)

    def shared_error_modes(self, prediction: StatePrediction) -> list[FloatArray]:
        """Return factors (K, 1) or (K, J), one standard deviation each, by which shared equation errors vary.

        They vary with force, with the reading of a taxel, over the session, and from phase to phase.
        """
        samples = self.forward.samples
        force = np.nan_to_num(samples.contacts.force_n) * samples.touching
        factors = [_centred(force)[:, None], _centred(prediction.values)]
        factors.append(np.linspace(-1.0, 1.0, len(samples))[:, None])
        if samples.phase is not None:
            factors += [(samples.phase == p)[:, None].astype(np.float64) for p in np.unique(samples.phase)]
        return factors

    def linearise(
        self,
        state: State,
        free: tuple[FreeParameter, ...],
        prediction: StatePrediction | None = None,
        *,
        word: bool = False,
    ) -> Fitted:
        """Linearise a state."""
        prediction = self.forward.predict(state) if prediction is None else prediction
        return self.linearised(prediction, free, *self.columns_of(prediction, free, word=word))

    def columns_of(
        self, prediction: StatePrediction, free: tuple[FreeParameter, ...], *, word: bool = False
    ) -> tuple[Whitened, int]:
        """Whiten all columns, and return how many of the last ones are equation errors."""
        own, shared = self.equation_errors(prediction, word=word)
        columns = Slopes.joined([self.columns(prediction, free), Slopes.of(shared)])
        return self.whitened(prediction, columns, own), shared.shape[2]

    def linearised(
        self,
        prediction: StatePrediction,
        free: tuple[FreeParameter, ...],
        w: Whitened,
        errors: int = 0,
        **more: object,
    ) -> Fitted:
        """Build a linearisation from whitened columns; those beyond the model's have no prior."""
        state = prediction.state
        found = self.blocks(w, state.move, **more)
        prior, pull = self.prior(state, free)
        return Fitted(
            prediction, free, found, np.append(prior, np.ones(errors)), np.append(pull, np.zeros(errors))
        )

    def blocks(self, w: Whitened, at: FloatArray, **more: object) -> Blocks:
        """Build normal equations of whitened columns, with presses at their moves (P, 3)."""
        return blocks(
            w, self._rows, at, self.priors.move, image=self.priors.image, **more  # type: ignore[arg-type]
        )  # fmt: skip

    def prior(self, state: State, free: tuple[FreeParameter, ...]) -> tuple[FloatArray, FloatArray]:
        """Return the prior precisions (n,), and the slope of the prior at a state."""
        prior = np.concatenate([self.priors.base, 1 / law_widths() ** 2, [1 / f.sigma**2 for f in free]])
        off = np.concatenate(
            [self.base_offset(state), state.law, [f.get(state.effects) - f.middle for f in free]]
        )
        return prior, prior * off

    def base_offset(self, state: State) -> FloatArray:
        """Return the distance (6,) of the base from its start: place, turn, angle, logarithms of E and S, rest."""
        a, b = state.pose, self.priors.start.pose
        turn = (a.beta_rad - b.beta_rad) * self.turning_radius(state) + a.x_m - b.x_m
        s = np.mean(state.log_s) - np.mean(self.priors.start.log_s)
        e, rest = state.log_e - self.priors.start.log_e, state.rest - self.priors.start.rest
        return np.array([a.y_m - b.y_m, turn, a.alpha_rad - b.alpha_rad, e, s, rest])

    def turning_radius(self, state: State) -> float:
        """Return the distance of the patch from the axis of its turn [m]; 0 on a plane."""
        return self.forward.surface.arc_radius_at(state.pose) or 0.0

    def gauss_newton_step(self, at: Fitted) -> FloatArray:
        """Return a Gauss-Newton step (n,) of base, law and free parameters within their bounds (active set)."""
        b, s = at.blocks, at.state
        h, g = b.h.sum(axis=0) + np.diag(at.prior), b.b.sum(axis=0) - at.pull
        size = 1 / np.sqrt(np.diag(h))
        h, g = h * np.outer(size, size), g * size
        # Parameters at their bound or largest step are held there, and the others solved again.
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
                return self._limited(d * size)
            held |= beyond
            d = np.clip(d, low / size, high / size)

    def _limited(self, d: FloatArray) -> FloatArray:
        """Limit a step (n,) in the base."""
        limit = _MOST * np.array([1, 1, 1, 1, 1, self.forward.noise.frame])
        return np.append(np.clip(d[: len(limit)], -limit, limit), d[len(limit) :])

    def moved(self, at: Fitted, d: FloatArray, columns: IntArray | None = None) -> State:
        """Apply a limited step to a state; presses follow it.

        Args:
            at: linearisation.
            d: step of base, law and free parameters; with ``columns``, of these.
            columns: columns of the blocks that the step belongs to, those of the model first; None: the first ones.
        """
        b, s = at.blocks, at.state
        own, rest = self._limited(d[: len(at.prior)]), (np.arange(len(d)) if columns is None else columns)
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
        move[:, :2] = np.clip(move[:, :2], -self.priors.slack_m, self.priors.slack_m)
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

    def solve(self, state: State, free: tuple[FreeParameter, ...] = (), steps: int = 4) -> Fitted:
        """Fit from a state without equation errors; a step that increases the loss is shortened."""
        at = self.linearise(state, free, word=True)
        for _ in range(steps):
            d = self.gauss_newton_step(at)
            if at.linear_gain(d) < C.settled:
                break
            for part in (1.0, 0.3, 0.1):
                new, prediction, total = self._take_step(at, part * d)
                if total < at.loss() + C.loose:
                    break
            else:
                break
            gained = at.loss() - total
            at = self.linearise(new, free, prediction, word=True)
            if gained < C.settled:
                break
        return self.linearise(at.state, free, at.prediction) if at.state.effects else at

    def _take_step(self, at: Fitted, d: FloatArray) -> tuple[State, StatePrediction, float]:
        """Apply a step, let each press take steps of its own, and return the state, its prediction and its loss."""
        state, prediction, loss = self.profile_presses(self.moved(at, d))
        prior, pull = self.prior(state, at.free)
        return state, prediction, float(loss.sum() + (pull**2 / np.maximum(prior, 1e-300)).sum())

    def profile_presses(
        self, state: State, steps: int = C.own_steps, rows: IntArray | None = None
    ) -> ProfiledState:
        """Move each press, or those of some rows, by Levenberg-Marquardt steps of its nuisance parameters.

        Each press has its own damping: the data often determine its place in one direction and hardly in the other.
        """
        every = np.arange(len(state.move))
        some = np.isin(every, every if rows is None else rows)
        prediction, found = self.residual_blocks(state)
        best = _of_presses(found, found.loss, len(state.move))
        owner, damping, ways = found.press, np.full(len(state.move), _DAMPING), [x.copy() for x in found.own]
        ahead = _of_presses(found, found.ahead, len(state.move))
        for _ in range(steps):
            # A press with nothing to gain keeps its place and its table.
            if not (going := some & (ahead[:-1] > C.loose)).any():
                break
            new = replace(state, move=self._own_move(state.move, ways, owner, damping, going))
            prediction, found = self.residual_blocks(new)
            loss, ahead_now = (_of_presses(found, x, len(state.move)) for x in (found.loss, found.ahead))
            better = loss < best
            damping *= np.where(better[:-1], 0.2, 6.0)
            ways[0][better[owner]], ways[1][better[owner]] = (x[better[owner]] for x in found.own)
            state = replace(state, move=np.where(better[:-1, None], new.move, state.move))
            best, ahead = np.minimum(best, loss), np.where(better, ahead_now, ahead)
        if not (state.move == prediction.state.move).all():
            prediction = self.forward.predict(state)
        return ProfiledState(prediction.state, prediction, best)

    def _own_move(
        self,
        move: FloatArray,
        ways: Sequence[FloatArray],
        owner: IntArray,
        damping: FloatArray,
        going: BoolArray,
    ) -> FloatArray:
        """Return the moves (P, 3) after a limited step of some presses, from their curvatures and slopes."""
        own, (h, g) = (owner >= 0) & going[np.maximum(owner, 0)], ways
        p, three = owner[own], np.arange(-3, 0)
        h = h[own]
        h[:, three, three] *= 1 + damping[p, None]
        step = np.linalg.solve(h, g[own][..., None])[:, -3:, 0]
        move = move.copy()
        move[p] += step / np.maximum(1.0, np.abs(step / _REACH).max(axis=1))[:, None]
        move[:, :2] = np.clip(move[:, :2], -self.priors.slack_m, self.priors.slack_m)
        return move

    def residual_blocks(self, state: State) -> tuple[StatePrediction, Blocks]:
        """Predict a state, and build the normal equations of its residual."""
        prediction = self.forward.predict(state)
        own, none = self.equation_errors(prediction, word=True)
        return prediction, self.blocks(self.whitened(prediction, none, own), state.move)


def law_widths() -> FloatArray:
    """Return the prior standard deviations (4,) of the contact law's parameters in a state."""
    return np.array([C.law_power, C.law_blur, C.law_radius, C.law_bare])


def law_bounds() -> FloatArray:
    """Return their bounds (4, 2)."""
    return law_widths()[:, None] * _LAW


def _of_presses(blocks: Blocks, values: FloatArray, presses: int) -> FloatArray:
    """Sum values of blocks by press (P,), with what belongs to no press last (P + 1,)."""
    owner = np.where(blocks.press >= 0, blocks.press, presses)
    return np.bincount(owner, values, presses + 1).astype(np.float64)


def _centred(x: FloatArray) -> FloatArray:
    """Scale numbers from 0 to their maximum to -1 to 1."""
    return 2 * x / max(float(x.max(initial=0.0)), 1e-12) - 1
