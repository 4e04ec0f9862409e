"""Evidence for a nonlinear response: refits of the same presses with taxels that respond along a curve.

Position, E and S absorb much of the effect of a nonlinear response on an image, and the force error of the
press absorbs more. What remains shows across presses: images of a skin do not grow with the force as
nonlinear readings do. The presses are therefore fitted again, from the peak, with a few curves of
:class:`skincal.fitting.readings.Response`: powers of the load, and saturation curves. The best evidence is
compared with that of the linear response. Force errors that a nonlinear response would reduce are thus
evidence for it, even if the fit as it is explains them as force errors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from skincal.fitting.posterior import Peak
from skincal.fitting.problem import FitProblem
from skincal.fitting.readings import STRAIGHT, Response

POWERS = (-0.25, 0.12, 0.25)
"""Losses of power from the noise level on: readings that grow as the load to the power 1.25, 0.88 and 0.75."""

CEILINGS = ((1.15, 4.0), (1.5, 2.0))
"""Saturation levels as fractions of the largest reading, and the sharpness of the knee."""


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
