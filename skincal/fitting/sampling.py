"""Draws of a posterior: adaptive importance sampling, and an ensemble of walkers where its draws are worth too little.

Adaptive importance sampling is that of Cappe et al. (2008) with the mixture weights of Cornuet et al. (2012); proposals
are fitted to tempered weights. The ensemble is the affine-invariant one of Goodman and Weare (2010), by `emcee`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import gammaln, logsumexp

from skincal.fitting.observe import TO_SIGMA
from skincal.fitting.posterior import Peak
from skincal.fitting.problem import NOWHERE, FitError, FitProblem
from skincal.fitting.types import Floats

_SHAPE = 8
"""The shape of a proposal is told by so many independent draws for each of its dimensions."""


@dataclass(frozen=True, eq=False)
class Draws:
    """Weighted draws of the posterior.

    Attributes:
        points: (W, 11) macro variables and log sigmas.
        weight: (W,) normalised weights.
        correlation: steps of a walker after which it has forgotten where it was; 1 for independent draws.
    """

    points: Floats
    weight: Floats
    correlation: float = 1.0

    @property
    def effective(self) -> float:
        """Return how many independent draws the weighted ones are worth."""
        return float(1.0 / (self.weight**2).sum() / max(self.correlation, 1.0))

    @property
    def mean(self) -> Floats:
        """The weighted mean (11,): the best point, and the logarithms of the sigmas."""
        return self.weight @ self.points

    @property
    def spread(self) -> Floats:
        """Standard deviations (11,)."""
        return np.maximum(np.sqrt(self.weight @ (self.points - self.mean) ** 2), 1e-300)

    def resampled(self, rng: np.random.Generator, count: int) -> Floats:
        """(count, 11) draws of equal weight, by systematic resampling."""
        at = (rng.random() + np.arange(count)) / count
        rows = np.minimum(np.searchsorted(np.cumsum(self.weight), at), len(self.weight) - 1)
        return self.points[rng.permutation(rows)]


Density = Callable[[Floats], Floats]
"""Takes points (W, 11) to log densities (W,); may spread them over workers."""

SOUND = 50
"""Draws that are worth so many independent ones say where a smooth term of the log density matters."""


def sample(
    peak: Peak,
    problem: FitProblem,
    density: Density,
    rng: np.random.Generator,
    *,
    size: int,
    rounds: tuple[int, int],
    worth: float,
    lacking: Density | None = None,
    checked: int = 0,
    on_round: Callable[[int], None] = lambda _done: None,
) -> tuple[Draws, Density]:
    """Adaptive importance sampling round a peak.

    Args:
        peak: where to start.
        problem: the presses.
        density: the log posterior.
        rng: the only source of chance.
        size: draws in each round; after each the proposal is fitted to all draws so far.
        rounds: fewest and most.
        worth: enough are draws that are worth so many independent ones.
        lacking: a smooth term that the density lacks, and that takes long to find; it is fitted and added before the
            last of the fewest rounds, and anew where the draws then go elsewhere.
        checked: points at which it is found.
        on_round: told the rounds done.

    Returns:
        All draws, weighted against the mixture of all proposals, and the density that they are of.

    Raises:
        FitError: the presses have no density anywhere near the peak.
    """
    if not np.isfinite(peak.covariance).all():
        raise FitError(NOWHERE)
    lit, presses = float(problem.lit.sum()), len(problem)
    hyper = np.array([0.7 / presses**0.5, 0.8, 0.7 / lit**0.5, 0.8, 0.8, 0.8]) ** 2
    covariance = np.zeros((5 + len(hyper), 5 + len(hyper)))
    covariance[:5, :5] = peak.covariance
    covariance[5:, 5:] = np.diag(hyper)
    proposals = [_Student(np.concatenate([peak.macro, np.log(peak.sigmas)]), covariance * 1.5)]
    points, plain = np.empty((0, len(covariance))), np.empty(0)
    fewest, most = rounds
    term: Density | None = None
    stale, left, about = lacking is not None, FITS, points
    while True:
        fresh = proposals[-1].draw(rng, size)
        found = density(fresh)
        points = np.concatenate([points, fresh])
        plain = np.concatenate([plain, np.where(np.isfinite(found), found, -np.inf)])
        if not np.isfinite(plain).any():
            raise FitError(NOWHERE)
        draws, done = _weighted(points, plain, term, proposals), len(proposals)
        # Have the draws gone from where the term was fitted, about a mean, with a spread?
        stale = stale or (
            term is not None and left > 0 and bool((np.abs(draws.mean - about[0]) > STRAYED * about[1]).any())
        )
        if (
            lacking is not None
            and stale
            and (done >= most or (done >= fewest - 1 and draws.effective >= SOUND))
        ):
            about, left, stale = np.stack([draws.mean, draws.spread]), left - 1, False
            term = smooth_term(draws, lacking, checked, rng)
            draws = _weighted(points, plain, term, proposals)
        on_round(done)
        if done >= most or (done >= fewest and draws.effective >= worth and not stale):
            return draws, density if (own := term) is None else lambda points: density(points) + own(points)
        proposals.append(_adapted(draws, proposals[-1]))


FITS, STRAYED = 3, 1.5
"""A smooth term is fitted so often, each time as the draws have gone by so many standard deviations since."""


def _weighted(points: Floats, plain: Floats, term: Density | None, proposals: Sequence[_Student]) -> Draws:
    """Draws weighted against the mixture of all proposals, which have drawn equally many points."""
    values = plain if term is None else plain + term(points)
    log_weight = values - logsumexp([p.log_density(points) for p in proposals], axis=0)
    weight = np.exp(log_weight - log_weight.max())
    return Draws(points, weight / weight.sum())


def smooth_term(draws: Draws, lacking: Density, count: int, rng: np.random.Generator) -> Density:
    """A fit to a smooth term of a log density, where the draws are, from its values at ``count`` points.

    It is linear in all variables and quadratic in log E and log S, by least squares with a prior of one unit for each
    coefficient in standard deviations of the draws; the term may be noisier than that.
    """
    some = Draws(draws.points, _tempered(draws.weight, float(count)))
    middle, spread = some.mean, some.spread

    def parts(at: Floats) -> Floats:
        z = np.clip((at - middle) / spread, -4.0, 4.0)
        return np.column_stack([np.ones(len(z)), z, z[:, 3] ** 2, z[:, 4] ** 2, z[:, 3] * z[:, 4]])

    points = some.resampled(rng, count)
    rise = lacking(points)
    known = np.isfinite(rise)
    x, y = parts(points[known]), rise[known]
    keep, found = np.ones(len(y), dtype=bool), np.zeros(x.shape[1])
    if len(y) >= 2 * x.shape[1]:
        for _ in range(3):
            noise = 1.0 if not found.any() else float(np.var((y - x @ found)[keep]))
            prior = np.diag([0.0] + [max(noise, 1e-6)] * (x.shape[1] - 1))
            found = np.linalg.solve(x[keep].T @ x[keep] + prior, x[keep].T @ y[keep])
            off = np.abs(y - x @ found)
            keep = off <= 4 * TO_SIGMA * max(float(np.median(off)), 1e-9)
    return lambda at: parts(at) @ found


WALKERS, BURN_IN, STEPS = 44, 60, 220
"""Walkers of the ensemble (four a dimension), steps that they first take to spread, and steps that are kept."""


def walk(density: Density, start: Draws, rng: np.random.Generator) -> Draws:
    """Draws of an ensemble of walkers, which needs no proposal that resembles the posterior."""
    import emcee  # pyright: ignore[reportMissingTypeStubs] - it loads scipy.stats, and few fits need it

    spread = Draws(start.points, _tempered(start.weight, float(WALKERS)))
    scale = spread.spread
    at, found = np.empty((0, start.points.shape[1])), 0
    while len(at) < WALKERS and found < 50:
        # Nudged, so that no two walkers stand at one point and all directions are open.
        some = spread.resampled(rng, WALKERS)
        some = some + 0.1 * scale * rng.standard_normal(some.shape)
        at, found = np.concatenate([at, some[np.isfinite(density(some))]]), found + 1
    if len(at) < WALKERS:
        return start
    walkers: Any = emcee.EnsembleSampler(WALKERS, at.shape[1], density, vectorize=True)
    seed = np.random.RandomState(int(rng.integers(2**31))).get_state()
    state: Any = walkers.run_mcmc(emcee.State(at[:WALKERS], random_state=seed), BURN_IN)
    walkers.reset()
    walkers.run_mcmc(state, STEPS)
    time = float(np.nanmax(walkers.get_autocorr_time(quiet=True, tol=0)))
    points = np.asarray(walkers.get_chain(flat=True), dtype=np.float64)
    return Draws(points, np.full(len(points), 1.0 / len(points)), time if np.isfinite(time) else float(STEPS))


class _Student:
    """A multivariate t distribution with 6 degrees of freedom: tails heavier than the target's."""

    def __init__(self, mean: Floats, covariance: Floats, freedom: float = 6.0) -> None:
        self.mean, self.freedom = mean, freedom
        scale = np.sqrt(np.maximum(np.diag(covariance), 1e-30))
        correlation = covariance / np.outer(scale, scale)
        values, vectors = np.linalg.eigh((correlation + correlation.T) / 2)
        self.root = scale[:, None] * vectors * np.sqrt(np.maximum(values, 1e-6))
        self.covariance = covariance

    def draw(self, rng: np.random.Generator, count: int) -> Floats:
        normal = rng.standard_normal((count, len(self.mean)))
        stretch = np.sqrt(self.freedom / rng.chisquare(self.freedom, count))
        return self.mean + (normal * stretch[:, None]) @ self.root.T

    def log_density(self, points: Floats) -> Floats:
        d, v = len(self.mean), self.freedom
        z = np.linalg.solve(self.root, (points - self.mean).T)
        constant = gammaln((v + d) / 2) - gammaln(v / 2) - d / 2 * np.log(v * np.pi)
        determinant = np.linalg.slogdet(self.root)[1]
        return constant - determinant - (v + d) / 2 * np.log1p((z**2).sum(axis=0) / v)


def _adapted(draws: Draws, last: _Student) -> _Student:
    """A proposal with the moments of the draws so far, tempered where a few heavy ones would tell the shape."""
    tempered = _tempered(draws.weight, _SHAPE * draws.points.shape[1])
    mean = tempered @ draws.points
    covariance = (tempered[:, None] * (draws.points - mean)).T @ (draws.points - mean)
    return _Student(mean, 1.15 * covariance + 1e-3 * np.diag(np.diag(last.covariance)))


def _tempered(weight: Floats, least: float) -> Floats:
    """Weights to the highest power up to 1 at which they are worth ``least`` independent draws."""
    logs = np.log(np.maximum(weight, 1e-300))

    def at(power: float) -> Floats:
        raised = np.exp(power * (logs - logs.max())) * (weight > 0)
        return raised / raised.sum()

    low, high = 0.0, 1.0
    if 1.0 / (weight**2).sum() >= least:
        return weight
    for _ in range(30):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if 1.0 / (at(middle) ** 2).sum() >= least else (low, middle)
    return at(low)
