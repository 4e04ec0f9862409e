"""Posterior draws: adaptive importance sampling, and an ensemble of walkers if its effective sample size is too small.

Adaptive importance sampling follows Cappe et al. (2008), with the mixture weights of Cornuet et al. (2012);
proposals are fitted to tempered weights. The ensemble is the affine-invariant one of Goodman and Weare
(2010), by `emcee`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import gammaln, logsumexp

from skincal.fitting.posterior import Peak
from skincal.fitting.problem import NO_DENSITY, FitError, FitProblem
from skincal.fitting.types import Floats
from skincal.statistics import TO_SIGMA

_DRAWS_PER_DIMENSION = 8
"""Least effective sample size per dimension to which the weights are tempered when a proposal is fitted."""


@dataclass(frozen=True, eq=False)
class Draws:
    """Weighted draws of the posterior.

    Attributes:
        points: (W, 11) macro variables and logs of the sigmas.
        weight: (W,) normalised weights.
        correlation: autocorrelation time of a walker in steps; 1 for independent draws.
    """

    points: Floats
    weight: Floats
    correlation: float = 1.0

    @property
    def effective(self) -> float:
        """Effective sample size."""
        return float(1.0 / (self.weight**2).sum() / max(self.correlation, 1.0))

    @property
    def mean(self) -> Floats:
        """Weighted mean (11,): the best point, and the logs of the sigmas."""
        return self.weight @ self.points

    @property
    def spread(self) -> Floats:
        """Standard deviations (11,)."""
        return np.maximum(np.sqrt(self.weight @ (self.points - self.mean) ** 2), 1e-300)

    def resampled(self, rng: np.random.Generator, count: int) -> Floats:
        """Return (count, 11) draws of equal weight, by systematic resampling."""
        at = (rng.random() + np.arange(count)) / count
        rows = np.minimum(np.searchsorted(np.cumsum(self.weight), at), len(self.weight) - 1)
        return self.points[rng.permutation(rows)]


Density = Callable[[Floats], Floats]
"""Log density (W,) of points (W, 11); may run on several workers."""

TERM_DRAWS = 50
"""Least effective sample size from which the smooth term of the log density is fitted."""


def sample(
    peak: Peak,
    problem: FitProblem,
    density: Density,
    rng: np.random.Generator,
    *,
    size: int,
    rounds: tuple[int, int],
    enough_draws: float,
    expensive_term: Density | None = None,
    term_points: int = 0,
    on_round: Callable[[int], None] = lambda _done: None,
) -> tuple[Draws, Density]:
    """Run adaptive importance sampling of a log density around a peak.

    Args:
        peak: where to start.
        problem: the presses.
        density: the log posterior.
        rng: only source of randomness.
        size: draws in each round.
        rounds: fewest and most.
        enough_draws: effective sample size at which sampling stops.
        expensive_term: a smooth, expensive term that the density lacks. When one round is left of the fewest, a
            function is fitted to it and added; it is fitted again if the draws then move elsewhere.
        term_points: number of points at which the term is evaluated.
        on_round: callback with the number of finished rounds.

    Returns:
        All draws, weighted against the mixture of all proposals, and the density that they follow.

    Raises:
        FitError: the density is zero everywhere near the peak.
    """
    if not np.isfinite(peak.covariance).all():
        raise FitError(NO_DENSITY)
    readings, presses = float(problem.used.sum()), len(problem)
    hyper = np.array([0.7 / presses**0.5, 0.8, 0.7 / readings**0.5, 0.8, 0.8, 0.8]) ** 2
    covariance = np.zeros((5 + len(hyper), 5 + len(hyper)))
    covariance[:5, :5] = peak.covariance
    covariance[5:, 5:] = np.diag(hyper)
    proposals = [_Student(np.concatenate([peak.macro, np.log(peak.sigmas)]), covariance * 1.5)]
    points, plain, mixture = np.empty((0, len(covariance))), np.empty(0), np.empty(0)
    fewest, most = rounds
    term: Density | None = None
    stale, left, about = expensive_term is not None, MOST_TERM_FITS, points
    while True:
        fresh = proposals[-1].draw(rng, size)
        found = density(fresh)
        # Log of the sum of all proposals' densities: at earlier points only the last one is new.
        mixture = np.concatenate([
            np.logaddexp(mixture, proposals[-1].log_density(points)),
            logsumexp([one.log_density(fresh) for one in proposals], axis=0),
        ])  # fmt: skip
        points = np.concatenate([points, fresh])
        plain = np.concatenate([plain, np.where(np.isfinite(found), found, -np.inf)])
        if not np.isfinite(plain).any():
            raise FitError(NO_DENSITY)
        draws, done = _weigh_draws(points, plain, term, mixture), len(proposals)
        # Refit the term if the draws have moved away from where it was fitted (mean and spread in
        # ``about``).
        stale = stale or (
            term is not None and left > 0 and bool((np.abs(draws.mean - about[0]) > DRIFT * about[1]).any())
        )
        if (
            expensive_term is not None
            and stale
            and (done >= most or (done >= fewest - 1 and draws.effective >= TERM_DRAWS))
        ):
            about, left, stale = np.stack([draws.mean, draws.spread]), left - 1, False
            term = smooth_term(draws, expensive_term, term_points, rng)
            draws = _weigh_draws(points, plain, term, mixture)
        on_round(done)
        if done >= most or (done >= fewest and draws.effective >= enough_draws and not stale):
            return draws, density if (own := term) is None else lambda points: density(points) + own(points)
        proposals.append(_adapt_proposal(draws, proposals[-1]))


MOST_TERM_FITS, DRIFT = 3, 1.5
"""The smooth term is fitted at most this often, each time after the mean has moved by ``DRIFT`` standard deviations."""


def _weigh_draws(points: Floats, plain: Floats, term: Density | None, mixture: Floats) -> Draws:
    """Weight draws against the mixture of all proposals, each of which has drawn equally many points."""
    log_weight = (plain if term is None else plain + term(points)) - mixture
    weight = np.exp(log_weight - log_weight.max())
    return Draws(points, weight / weight.sum())


def smooth_term(draws: Draws, expensive_term: Density, count: int, rng: np.random.Generator) -> Density:
    """Fit a smooth term of a log density near the draws, from its values at ``count`` points.

    The fit is linear in all variables and quadratic in log E and log S. It is a robust least-squares fit with
    a unit Gaussian prior on each coefficient, in standard deviations of the draws; values of the term may be
    noisy.
    """
    some = Draws(draws.points, _temper(draws.weight, float(count)))
    middle, spread = some.mean, some.spread

    def parts(at: Floats) -> Floats:
        z = np.clip((at - middle) / spread, -4.0, 4.0)
        return np.column_stack([np.ones(len(z)), z, z[:, 3] ** 2, z[:, 4] ** 2, z[:, 3] * z[:, 4]])

    points = some.resampled(rng, count)
    rise = expensive_term(points)
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
"""Walkers of the ensemble (four per dimension), burn-in steps, and steps that are kept."""


def run_ensemble(density: Density, start: Draws, rng: np.random.Generator) -> Draws:
    """Draw by an ensemble of walkers, which needs no proposal that resembles the posterior."""
    import emcee  # pyright: ignore[reportMissingTypeStubs] - it loads scipy.stats, and few fits need it

    spread = Draws(start.points, _temper(start.weight, float(WALKERS)))
    scale = spread.spread
    at, found = np.empty((0, start.points.shape[1])), 0
    while len(at) < WALKERS and found < 50:
        # Perturb the starts, so that no two walkers coincide and they span all directions.
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
    """A multivariate t distribution with 6 degrees of freedom: its tails are heavier than the target's."""

    def __init__(self, mean: Floats, covariance: Floats, freedom: float = 6.0) -> None:
        self.mean, self.freedom = mean, freedom
        scale = np.sqrt(np.maximum(np.diag(covariance), 1e-30))
        correlation = covariance / np.outer(scale, scale)
        values, vectors = np.linalg.eigh((correlation + correlation.T) / 2)
        self.root = scale[:, None] * vectors * np.sqrt(np.maximum(values, 1e-6))
        self.covariance = covariance

    def draw(self, rng: np.random.Generator, count: int) -> Floats:
        """Return draws (count, D)."""
        normal = rng.standard_normal((count, len(self.mean)))
        stretch = np.sqrt(self.freedom / rng.chisquare(self.freedom, count))
        return self.mean + (normal * stretch[:, None]) @ self.root.T

    def log_density(self, points: Floats) -> Floats:
        """Return the log density (W,) of points (W, D)."""
        d, v = len(self.mean), self.freedom
        z = np.linalg.solve(self.root, (points - self.mean).T)
        constant = gammaln((v + d) / 2) - gammaln(v / 2) - d / 2 * np.log(v * np.pi)
        determinant = np.linalg.slogdet(self.root)[1]
        return constant - determinant - (v + d) / 2 * np.log1p((z**2).sum(axis=0) / v)


def _adapt_proposal(draws: Draws, last: _Student) -> _Student:
    """Return a proposal with the moments of all draws; tempering keeps a few heavy draws from dominating it."""
    tempered = _temper(draws.weight, _DRAWS_PER_DIMENSION * draws.points.shape[1])
    mean = tempered @ draws.points
    covariance = (tempered[:, None] * (draws.points - mean)).T @ (draws.points - mean)
    return _Student(mean, 1.15 * covariance + 1e-3 * np.diag(np.diag(last.covariance)))


def _temper(weight: Floats, least: float) -> Floats:
    """Raise weights to the highest power up to 1 at which their effective sample size is at least ``least``."""
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
