"""The one null: what every candidate gains in sessions with nothing hidden.

A null session has this session's presses, noise, rest and fitted parameters. Its residual is drawn: noise, or counts on
a staircase; the own numbers of presses by their priors; and what a contact law other than the model's leaves after the
base model has been fitted to it (twins), as far as the session itself can have that. With the columns of this session
the gain of a candidate is then the same linear algebra as for the data, so that a null session costs milliseconds.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from skincal.fitting.tasks import Mapper
from skincal.inference.blocks import Blocks
from skincal.inference.constants import CONSTANTS as C
from skincal.inference.fit import Fitted, Fitter
from skincal.inference.forward import State
from skincal.inference.gains import full_step, whole
from skincal.inference.start import raw_residual
from skincal.inference.twins import LAWS, name_of, twin_values
from skincal.model.arrays import FloatArray

FOUNDATION = "fitted law"
"""Name of the law of null sessions that have no other."""


@dataclass(frozen=True, eq=False)
class Null:
    """Gains of candidates in sessions with nothing hidden.

    Attributes:
        laws: name of the contact law of each of S sessions.
        gains: by effect, (S,) the greatest gain of any of its starts [nats].
        left: (S, 3) what a check of the base model says of each (:func:`skincal.inference.check.left`).
        level: part of the sessions that a limit is to exceed.
    """

    laws: tuple[str, ...]
    gains: dict[str, FloatArray]
    left: FloatArray
    level: float = C.null_quantile

    def quantile(self, name: str) -> float:
        """The gain that an effect seldom exceeds with nothing hidden [nats]."""
        own = self.gains.get(name)
        return 0.0 if own is None else float(np.quantile(own, self.level))

    def limit(self, name: str) -> float:
        """The gain that an effect must have to be named [nats]."""
        return max(C.least_gain, C.slack * self.quantile(name))

    def left_limits(self) -> FloatArray:
        """(3,) what a model may leave: what null sessions leave, and a margin."""
        return 1 + C.slack * np.maximum(np.quantile(self.left, self.level, axis=0) - 1, C.noise)

    def p_value(self, name: str, gain: float) -> float:
        """Part of null sessions in which an effect gains as much."""
        return (1 + float((self.gains.get(name, np.zeros(0)) >= gain).sum())) / (1 + len(self.laws))


def law_residuals(fitter: Fitter, base: Fitted, mapper: Mapper = map) -> dict[str, FloatArray]:
    """(N, J) what other contact laws leave after the base model's fit, whitened, robust weights in."""
    found = dict[str, FloatArray]()
    for law, numbers in LAWS.items():
        left = mapper(_twin_residual, [(fitter, base.state, law, number) for number in numbers])
        found |= {
            name_of(law, number): x * _weights(fitter)
            for number, x in zip(numbers, left, strict=True)
            if x is not None
        }
        if found:
            break
    return found


def _twin_residual(twin: tuple[Fitter, State, str, float]) -> FloatArray | None:
    """What the base model's fit leaves of a session under another law."""
    fitter, state, law, number = twin
    f, values = fitter.forward, twin_values(fitter.forward, state, law, number)
    if values is None:
        return None
    mean, _ = f.noise.written(values + state.rest)
    before = replace(fitter.before, weights=np.ones(fitter.counts.shape))
    other = Fitter(f, np.where(np.isfinite(fitter.counts), f.mean @ mean, np.nan), before)
    fit = other.solve(replace(state, effects={}), steps=C.few_steps)
    return np.nan_to_num(raw_residual(other, fit.state))


def drawn_noise(fitter: Fitter, base: Fitted, rng: np.random.Generator, sessions: int) -> FloatArray:
    """(N, J, S) residuals of noise; laws are added behind the columns, nuisances where they go."""
    # The noise is known within its standard error.
    times = 1 + fitter.forward.noise.within * rng.standard_normal(sessions)
    if fitter.forward.noise.coarse:
        # A level near the edge of a step has a few large residuals, which have less weight in the data, too.
        drawn = np.clip(_on_stairs(fitter, base, rng, times), -C.huber, C.huber)
    else:
        drawn = times * rng.standard_normal((*fitter.counts.shape, sessions), dtype=np.float32)
    return drawn * _weights(fitter)[..., None]


def _weights(fitter: Fitter) -> FloatArray:
    return np.where(np.isfinite(fitter.counts), fitter.before.weights, 0.0)


def parts_of_laws(
    blocks: Blocks, prior: FloatArray, pull: FloatArray, sigma: FloatArray, laws: int
) -> FloatArray:
    """How much of what each law leaves the session can have (L,), 0 to 1.

    The residual of a law is a column like others: its multiple is fitted beside the base model alone, and beside every
    effect that may be missing. The most that either allows counts.

    Args:
        blocks: of the columns of the base model, those of candidates, and those of L laws last.
        prior: (m,) precisions of the base model's columns.
        pull: (m,) slope of their prior.
        sigma: of the candidates' columns beforehand.
        laws: L.
    """
    most, base, every = np.zeros(laws), len(prior), len(prior) + len(sigma)
    prior, pull = np.append(prior, 1 / sigma**2), np.append(pull, np.zeros(len(sigma)))
    for n in (base, every):
        h, b = whole(blocks, np.append(np.arange(n), every + np.arange(laws)))
        cross = h[:n, n:]
        step = full_step(h[:n, :n], b[:n], prior[:n], pull[:n])
        follow = full_step(h[:n, :n], cross, prior[:n], np.zeros_like(cross))
        # Beforehand it is about as much as 1, or what a law leaves nothing of would have no error.
        curve = 1 + np.diag(h[n:, n:]) - (cross * follow).sum(axis=0)
        part = (b[n:] - cross.T @ step) / curve
        most = np.maximum(most, part + C.alike / np.sqrt(curve))
    return np.minimum(most, 1.0)


def with_laws(blocks: Blocks, parts: FloatArray) -> tuple[FloatArray, FloatArray]:
    """``drawn`` (B, n, S) and ``drawn_chi`` (B, S) of sessions of which each has one law, so much of it.

    Args:
        blocks: with columns of L laws behind all others.
        parts: (L, S), 0 for the laws that a session does not have.
    """
    every = np.arange(blocks.b.shape[1])
    laws = every[len(every) - len(parts) :]
    by_law = blocks.products.between(every, laws)
    chi = blocks.drawn_chi + 2 * np.einsum("bls,ls->bs", blocks.drawn[:, laws], parts)
    return blocks.drawn + by_law @ parts, chi + np.einsum("blm,ls,ms->bs", by_law[:, laws], parts, parts)


def _on_stairs(fitter: Fitter, base: Fitted, rng: np.random.Generator, times: FloatArray) -> FloatArray:
    """Residuals (N, J, S) of counts in coarse steps, of levels within their spread, less what a line takes up."""
    f, noise, session = fitter.forward, fitter.forward.noise, fitter.forward.session
    level = f.mean @ (base.seen.values + base.state.rest)
    # Within a step a level may lie anywhere; beyond, it would only meet the ends of the converter.
    spread = np.minimum(f.mean @ fitter.spread(base.seen, f.press_columns(base.seen)), noise.step)
    mean, slope, _, _ = noise.moments(level, spread)
    # All of a hold is at one level.
    group = np.where(session.held(), session.press, session.presses + np.arange(len(session)))
    _, group = np.unique(group, return_inverse=True)
    sessions = len(times)
    off = spread[..., None] * rng.standard_normal((group.max() + 1, level.shape[1], sessions))[group]
    frames, total = np.maximum(np.rint(fitter.frames), 1), np.zeros_like(off)
    sd = np.hypot(noise.sigma, noise.grows * np.maximum(level - noise.rest, 0.0))[..., None] * times
    for k in range(int(frames.max())):
        rows = frames > k
        shape = (int(rows.sum()), *off.shape[1:])
        total[rows] += noise.rounded(level[rows, :, None] + off[rows] + sd[rows] * rng.standard_normal(shape))
    left = total / frames[:, None, None] - mean[..., None] - slope[..., None] * off
    return left / np.sqrt(fitter.expected(base.seen)[2])[..., None]
