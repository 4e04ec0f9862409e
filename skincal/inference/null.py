"""The null distribution: what every candidate gains in sessions with nothing hidden.

A null session has this session's presses, noise, level at rest and fitted parameters. Its residual is simulated: noise,
or counts on a staircase; nuisance parameters of presses by their priors; and what another contact law leaves after the
base model has been fitted to it (:mod:`skincal.inference.twins`), as far as the session's own data allow that law. The
columns are those of this session, so the gain of a candidate is the same linear algebra as for the data, and a null
session costs milliseconds.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np

from skincal.fitting.tasks import Mapper
from skincal.inference.blocks import Blocks
from skincal.inference.constants import CONSTANTS as C
from skincal.inference.fit import Fitted, Fitter
from skincal.inference.forward import State
from skincal.inference.score import full_step, whole
from skincal.inference.start import raw_residual
from skincal.inference.twins import LAWS, law_name, twin_values
from skincal.model.arrays import FloatArray

FOUNDATION = "fitted law"
"""Name of the contact law of null sessions without a twin's residual."""


@dataclass(frozen=True, eq=False)
class Null:
    """Gains and misfits in S null sessions.

    Attributes:
        laws: name of the contact law of each session.
        gains: by effect, (S,) the greatest gain of any of its starts [nats].
        misfit: (S, 3) misfit of the base model in each (:func:`skincal.inference.score.misfit`).
        probability: of the quantile that sets a limit.
    """

    laws: tuple[str, ...]
    gains: dict[str, FloatArray]
    misfit: FloatArray
    probability: float = C.null_quantile

    def quantile(self, name: str) -> float:
        """Return the null quantile of the gain of an effect [nats]."""
        own = self.gains.get(name)
        return 0.0 if own is None else float(np.quantile(own, self.probability))

    def limit(self, name: str) -> float:
        """Return the gain that an effect must exceed to be selected [nats]."""
        return max(C.least_gain, C.limit_factor * self.quantile(name))

    def misfit_limits(self) -> FloatArray:
        """Return the misfit (3,) that a model may have: the null quantile and a margin."""
        return 1 + C.limit_factor * np.maximum(
            np.quantile(self.misfit, self.probability, axis=0) - 1, C.noise
        )

    def p_value(self, name: str, gain: float) -> float:
        """Return the part of null sessions in which an effect gains as much."""
        return (1 + float((self.gains.get(name, np.zeros(0)) >= gain).sum())) / (1 + len(self.laws))


def law_residuals(fitter: Fitter, base: Fitted, mapper: Mapper = map) -> Callable[[], dict[str, FloatArray]]:
    """Start to compute the residual (N, J) of the base model's fit under each other contact law.

    Returns:
        A function that waits for the residuals, whitened and weighted, by the name of the law: those of the first
        family of laws that applies.
    """

    def start(law: str) -> Iterable[FloatArray | None]:
        return mapper(_twin_residual, [(fitter, base.state, law, number) for number in LAWS[law]])

    first, *others = LAWS
    begun = start(first)

    def wait() -> dict[str, FloatArray]:
        for law in (first, *others):
            found = zip(LAWS[law], begun if law == first else start(law), strict=True)
            out = {law_name(law, number): x * _weights(fitter) for number, x in found if x is not None}
            if out:
                return out
        return {}

    return wait


def _twin_residual(twin: tuple[Fitter, State, str, float]) -> FloatArray | None:
    """Fit the base model to a session under another law, and return its residual; None if the law does not apply."""
    fitter, state, law, number = twin
    f, values = fitter.forward, twin_values(fitter.forward, state, law, number)
    if values is None:
        return None
    mean, _ = f.noise.written(values + state.rest)
    before = replace(fitter.priors, weights=np.ones(fitter.counts.shape))
    other = Fitter(f, np.where(np.isfinite(fitter.counts), f.mean @ mean, np.nan), before)
    fit = other.solve(replace(state, effects={}), steps=C.few_steps)
    return np.nan_to_num(raw_residual(other, fit.state))


def draw_noise(fitter: Fitter, base: Fitted, rng: np.random.Generator, sessions: int) -> FloatArray:
    """Draw whitened, weighted residuals (N, J, S) of noise alone, for S sessions."""
    # The noise is uncertain by its standard error.
    times = 1 + fitter.forward.noise.within * rng.standard_normal(sessions)
    if fitter.forward.noise.coarse:
        # Levels near the edge of a step have a few large residuals, which are clipped as the robust loss does.
        drawn = np.clip(_on_stairs(fitter, base, rng, times), -C.huber, C.huber)
    else:
        drawn = times * rng.standard_normal((*fitter.counts.shape, sessions), dtype=np.float32)
    return drawn * _weights(fitter)[..., None]


def _weights(fitter: Fitter) -> FloatArray:
    return np.where(np.isfinite(fitter.counts), fitter.priors.weights, 0.0)


def law_parts(
    blocks: Blocks, prior: FloatArray, pull: FloatArray, sigma: FloatArray, laws: int
) -> FloatArray:
    """Bound how much of the residual of each law (L,) the session's data allow, from 0 to 1.

    The residual of a law is a column, whose multiple is fitted twice: with the base model alone, and with every effect
    that may be missing. The bound is the larger estimate plus two standard errors.

    Args:
        blocks: of the columns of the base model, those of candidates, and those of L laws last.
        prior: (m,) precisions of the base model's columns.
        pull: (m,) gradient of their prior at the fit: precision times the distance from its mean.
        sigma: of the candidates' columns beforehand.
        laws: L.
    """
    most, base, every = np.zeros(laws), len(prior), len(prior) + len(sigma)
    prior, pull = np.append(prior, 1 / sigma**2), np.append(pull, np.zeros(len(sigma)))
    for n in (base, every):
        h, b = whole(blocks, np.append(np.arange(n), every + np.arange(laws)))
        cross = h[:n, n:]
        step = full_step(h[:n, :n], b[:n], prior[:n], pull[:n])
        absorbed = full_step(h[:n, :n], cross, prior[:n], np.zeros_like(cross))
        # The multiple has the prior N(0, 1), so that its error stays finite where a law leaves no residual.
        curve = 1 + np.diag(h[n:, n:]) - (cross * absorbed).sum(axis=0)
        part = (b[n:] - cross.T @ step) / curve
        most = np.maximum(most, part + C.alike / np.sqrt(curve))
    return np.minimum(most, 1.0)


def add_laws(blocks: Blocks, parts: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Add the residual of a law to null sessions: return slopes (B, n, S) and squares (B, S).

    Args:
        blocks: with the columns of L laws last, and slopes and squares of noise drawn.
        parts: (L, S) multiples of each law in each session.
    """
    every = np.arange(blocks.b.shape[1])
    laws = every[len(every) - len(parts) :]
    by_law = blocks.products.between(every, laws)
    chi = blocks.drawn_chi + 2 * np.einsum("bls,ls->bs", blocks.drawn[:, laws], parts)
    return blocks.drawn + by_law @ parts, chi + np.einsum("blm,ls,ms->bs", by_law[:, laws], parts, parts)


def _on_stairs(fitter: Fitter, base: Fitted, rng: np.random.Generator, times: FloatArray) -> FloatArray:
    """Draw residuals (N, J, S) of counts in coarse steps, less the linear response to the spread of levels."""
    f, noise, session = fitter.forward, fitter.forward.noise, fitter.forward.session
    level = f.mean @ (base.prediction.values + base.state.rest)
    # A level may lie anywhere within a step; a wider spread would only reach the ends of the converter.
    spread = np.minimum(
        f.mean @ fitter.level_sd(base.prediction, f.press_columns(base.prediction)), noise.step
    )
    mean, slope, _, _ = noise.moments(level, spread)
    # All frames of a hold are at one level.
    group = np.where(session.held(), session.press, session.presses + np.arange(len(session)))
    _, group = np.unique(group, return_inverse=True)
    sessions = len(times)
    off = (
        spread[..., None]
        * rng.standard_normal((group.max() + 1, level.shape[1], sessions), dtype=np.float32)[group]
    )
    frames, total = np.maximum(np.rint(fitter.frames), 1), np.zeros_like(off)
    sd = np.hypot(noise.sigma, noise.grows * np.maximum(level - noise.rest, 0.0))[..., None] * times
    for k in range(int(frames.max())):
        rows = frames > k
        shape = (int(rows.sum()), *off.shape[1:])
        drawn = sd[rows] * rng.standard_normal(shape, dtype=np.float32)
        total[rows] += noise.rounded(level[rows, :, None] + off[rows] + drawn)
    left = total / frames[:, None, None] - mean[..., None] - slope[..., None] * off
    return left / np.sqrt(fitter.expected(base.prediction)[2])[..., None]
