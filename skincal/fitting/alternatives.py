"""Alternatives to the model, weighed by their evidence: other contact laws, and nonlinear responses of the taxels.

A real skin also spreads pressure sideways, and its taxels may feel the pressure itself instead of the paper's
projections; both change E and S at nearly the same images. The climb is repeated under such laws. Half of the
draws are those of the foundation, the other half are moved as the laws require, so that intervals contain E and
S of whichever of these laws the skin has. In the same way a few curves of
:class:`skincal.fitting.readings.Response` are compared with the linear response; they change no parameter.
``docs/method/fit.md`` has the reasons.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import expit

from skincal.fitting.posterior import Peak
from skincal.fitting.problem import NO_DENSITY, FitError, FitProblem
from skincal.fitting.readings import STRAIGHT, Response
from skincal.fitting.types import Floats

POWERS = (-0.25, 0.12, 0.25)
"""Losses of power from the noise level on: readings that grow as the load to the power 1.25, 0.88 and 0.75."""

CEILINGS = ((1.15, 4.0), (1.5, 2.0))
"""Saturation levels as fractions of the largest reading, and the sharpness of the knee."""


@dataclass(frozen=True, eq=False)
class LawSpread:
    """Posterior of the contact law, and its effect on the macro variables.

    Attributes:
        widths_m: (N,) fine grid of spread widths [m].
        density: (N,) their posterior, summing to one.
        shift: (N, 5) of the macro variables relative to no spread.
        unprojected: probability that taxels feel the pressure itself.
        unprojected_shift: (5,) of the macro variables if they do.
    """

    widths_m: Floats
    density: Floats
    shift: Floats
    unprojected: float = 0.0
    unprojected_shift: Floats = field(default_factory=lambda: np.zeros(5))

    @property
    def best_m(self) -> float:
        """The most probable width [m]."""
        return float(self.widths_m[np.argmax(self.density)])

    @property
    def rise(self) -> float:
        """Log evidence of the widest spread over that of none; 0 unless it is the best of all."""
        if len(self.density) == 1 or np.argmax(self.density) < len(self.density) - 1:
            return 0.0
        return float(np.log(self.density[-1]) - np.log(max(self.density[0], np.finfo(float).tiny)))

    def shifted(self, draws: Floats, rng: np.random.Generator) -> Floats:
        """Return draws (W, 5) of the macro variables, each shifted by a law drawn at random."""
        moved = draws + self.shift[rng.choice(len(self.widths_m), len(draws), p=self.density)]
        return moved + (rng.random(len(draws)) < self.unprojected)[:, None] * self.unprojected_shift

    def with_unprojected(self, projected: Peak, unprojected: Peak) -> LawSpread:
        """Return the same with the evidence of taxels that feel the pressure itself.

        Args:
            projected: peak with taxels that feel the projected pressure.
            unprojected: peak with taxels that feel the pressure itself.
        """
        if not (np.isfinite(unprojected.log_evidence) and np.isfinite(unprojected.macro).all()):
            return self
        rise = unprojected.log_evidence - projected.log_evidence
        # Like a spread, it has no direction, so it cannot move or turn the sensor.
        shift = np.where(np.arange(5) < 3, 0.0, unprojected.macro - projected.macro)
        return replace(self, unprojected=float(expit(rise)), unprojected_shift=shift)


def weigh_laws(spreads_m: Floats, peaks: Sequence[Peak]) -> LawSpread:
    """Weigh contact laws by their evidence, with a flat prior over the widths.

    If the presses have no density under a law, that law and all wider spreads are excluded.

    Args:
        spreads_m: (L,) widths, growing from zero [m].
        peaks: the peak of the posterior at each.

    Raises:
        FitError: the presses have no density under the foundation either.
    """
    possible = [bool(np.isfinite(p.log_evidence) and np.isfinite(p.macro).all()) for p in peaks]
    if not possible[0]:
        raise FitError(NO_DENSITY)
    count = possible.index(False) if False in possible else len(possible)
    spreads_m, peaks = spreads_m[:count], peaks[:count]
    if len(spreads_m) == 1:
        return LawSpread(np.zeros(1), np.ones(1), np.zeros((1, 5)))
    from scipy.interpolate import PchipInterpolator  # slow to import; workers have it

    widths = np.linspace(0.0, float(spreads_m[-1]), 161)
    evidence = PchipInterpolator(spreads_m, [p.log_evidence for p in peaks])(widths)
    macro = np.stack([p.macro for p in peaks])
    # A spread has no direction, so it cannot move or turn the sensor; differences there are numerical
    # noise of the search.
    macro[:, :3] = macro[0, :3]
    # A Gaussian of small width acts by its variance: shifts start quadratically.
    shift = PchipInterpolator(spreads_m**2, macro - macro[0])(widths**2)
    density = np.exp(evidence - evidence.max())
    return LawSpread(widths, density / density.sum(), shift)


@dataclass(frozen=True)
class Nonlinearity:
    """Nonlinearity of the response.

    Attributes:
        grows: factor by which the largest reading grows if the response is linearised and typical readings
            stay; 1 if no nonlinear response explains the presses better.
        rise: log evidence over that of a linear response.
    """

    grows: float = 1.0
    rise: float = 0.0


def candidate_responses(problem: FitProblem) -> tuple[Response, ...]:
    """Return the responses to compare.

    The first is linear: a climb that restarts may find better positions for some presses (13 in log evidence
    in a session whose readings had steps of eight times the noise), and neither a nonlinear response nor a
    contact law may win by that.
    """
    readings, largest = problem.observation, float(problem.values.max())

    def response(lost: float, knee: float, sharpness: float) -> Response:
        # Keep typical readings unchanged, so that a climb starts near its optimum.
        beyond = (readings.typical_counts / knee) ** sharpness
        return Response(lost, knee, sharpness, float((1.0 + beyond) ** (lost / sharpness)))

    powers = (response(lost, readings.noise_counts, 1.0) for lost in POWERS)
    return STRAIGHT, *powers, *(response(1.0, part * largest, sharpness) for part, sharpness in CEILINGS)


def with_response(problem: FitProblem, response: Response) -> FitProblem:
    """Return the problem with taxels of the given response."""
    return replace(problem, observation=replace(problem.observation, response=response))


def invert_response(response: Response, counts: float) -> float:
    """Return the signal [counts] at which a response reads ``counts``."""
    from scipy.optimize import brentq  # takes a moment, and a worker has it

    return float(brentq(lambda signal: response.of(signal) - counts, 0.0, 1e3 * counts))


def weigh_responses(
    problem: FitProblem, plain: Sequence[Peak], tried: Sequence[Response], peaks: Sequence[Peak]
) -> Nonlinearity:
    """Return the response that explains the presses best.

    Args:
        problem: the presses.
        plain: peaks of linear responses with every contact law that is weighed: a law, too, changes how
            images grow with the force.
        tried: the responses that were fitted.
        peaks: the peak of each.
    """
    found, least = [Nonlinearity()], float(np.nanmax([one.log_evidence for one in plain]))
    largest = float(problem.values.max())
    for response, one in zip(tried, peaks, strict=True):
        rise = one.log_evidence - least
        if np.isfinite(rise) and np.isfinite(one.macro).all():
            found.append(Nonlinearity(invert_response(response, largest) / largest, float(rise)))
    return max(found, key=lambda one: one.rise)
