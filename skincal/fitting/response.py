"""Evidence for a response that bends: the same presses, with taxels that answer by a curve.

Place, E and S take up much of what a bent response does to an image, and the error of the press's force takes up more.
What is left shows across presses: no skin grows with the force as bent images do. The presses are therefore fitted
again, from the peak, with a few curves of :class:`skincal.fitting.readings.Response`: powers of the load, and ceilings
that readings approach. The best evidence is compared with that of a straight line. So forces whose errors a straight
response would make small tell a bend even where the fit as it is takes them to be wrong.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from skincal.fitting.posterior import Peak
from skincal.fitting.problem import FitProblem
from skincal.fitting.readings import STRAIGHT, Response

POWERS = (-0.25, 0.12, 0.25)
"""Powers that are lost from the noise on: readings that grow as the load to the power 1.25, 0.88 and 0.75."""

CEILINGS = ((1.15, 4.0), (1.5, 2.0))
"""Ceilings that readings approach, in parts of the largest one, and how sharply."""


@dataclass(frozen=True)
class Bend:
    """A bend of the response.

    Attributes:
        grows: what the largest reading becomes where the response is made straight and typical readings stay, as a
            multiple; 1 where no bend explains the presses better.
        rise: log evidence of the bend over that of a straight response.
    """

    grows: float = 1.0
    rise: float = 0.0


def responses(problem: FitProblem) -> tuple[Response, ...]:
    """Return the responses that are compared.

    The first is straight: a climb that begins anew may find better places for some presses (13 in log evidence in a
    session in steps of eight times the noise), and neither a bend nor a contact law may win by that.
    """
    readings, largest = problem.observation, float(problem.values.max())

    def bent(lost: float, knee: float, sharpness: float) -> Response:
        # Typical readings stay, so that a climb begins near its end.
        beyond = (readings.typical_counts / knee) ** sharpness
        return Response(lost, knee, sharpness, float((1.0 + beyond) ** (lost / sharpness)))

    powers = (bent(lost, readings.noise_counts, 1.0) for lost in POWERS)
    return STRAIGHT, *powers, *(bent(1.0, part * largest, sharpness) for part, sharpness in CEILINGS)


def with_response(problem: FitProblem, response: Response) -> FitProblem:
    """Return the problem with taxels that answer by a response."""
    return replace(problem, observation=replace(problem.observation, response=response))


def straightened(response: Response, counts: float) -> float:
    """Return the signal [counts] whose response are ``counts``."""
    from scipy.optimize import brentq  # takes a moment, and a worker has it

    return float(brentq(lambda signal: response.of(signal) - counts, 0.0, 1e3 * counts))


def weigh_bends(
    problem: FitProblem, plain: Sequence[Peak], tried: Sequence[Response], peaks: Sequence[Peak]
) -> Bend:
    """Return the response that explains the presses best.

    Args:
        problem: the presses.
        plain: peaks of straight responses by every contact law that is weighed: a law, too, changes how images grow
            with the force.
        tried: the responses that were fitted.
        peaks: the peak of each.
    """
    found, least = [Bend()], float(np.nanmax([one.log_evidence for one in plain]))
    largest = float(problem.values.max())
    for response, one in zip(tried, peaks, strict=True):
        rise = one.log_evidence - least
        if np.isfinite(rise) and np.isfinite(one.macro).all():
            found.append(Bend(straightened(response, largest) / largest, float(rise)))
    return max(found, key=lambda bend: bend.rise)
