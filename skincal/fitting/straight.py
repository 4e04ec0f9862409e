"""Evidence for a response that bends: the same presses, with their readings straightened.

Place, E and S take up much of what a bent response does to an image, and the error of the press's force takes up more.
What is left shows across presses: no skin grows with the force as bent images do. Readings y above the level at rest
are therefore straightened to

    x = y (1 + b (y / y_0)^q)

with y_0 the largest one. The presses are fitted to them again, from the peak, and the evidence with the Jacobian of the
straightened readings is compared with that of b = 0. So forces whose errors a straight response would make small tell
a bend even where the fit as it is takes them to be wrong.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from skincal.fitting.posterior import Peak
from skincal.fitting.problem import FitProblem

BENDS = ((0.0, 1), (-0.3, 1), (0.3, 1), (1.0, 1), (1.0, 3))
"""Values of b and q that are tried: the largest reading becomes 0.7, 1.3, and twice what it is; evenly, or at once.

The first straightens nothing: a climb that begins anew may find better places for some presses (13 in log evidence in a
session in steps of eight times the noise), and neither a bend nor a contact law may win by that.
"""


@dataclass(frozen=True)
class Bend:
    """A straightening of the response.

    Attributes:
        grows: what the largest reading becomes, as a multiple; 1 where none explains the presses better.
        rise: log evidence of it over that of readings as they are.
    """

    grows: float = 1.0
    rise: float = 0.0


def straightened(problem: FitProblem, part: float, power: int) -> tuple[FitProblem, float]:
    """Return the problem with its readings straightened by b and q, and the log Jacobian of all that are used."""
    readings, above = problem.observation, np.maximum(problem.values, 0.0)
    bent = part * (above / max(float(above.max(initial=0.0)), np.finfo(float).tiny)) ** power
    slope = 1.0 + (1 + power) * bent
    read = replace(readings, target=readings.target + above * bent, share=readings.share * slope)
    read = replace(read, signal=read.spread(np.where(problem.lit, above * (1.0 + bent), 0.0)))
    log_jacobian = float(np.log(slope[problem.used]).sum())
    return replace(problem, values=problem.values + above * bent, observation=read), log_jacobian


def weigh_bends(plain: Sequence[Peak], straight: Sequence[Peak], log_jacobians: Sequence[float]) -> Bend:
    """Return the straightening that explains the presses best.

    Args:
        plain: peaks of the readings as they are, by every contact law that is weighed: with the force a law changes
            images, too.
        straight: peaks of the readings straightened by each of ``BENDS``.
        log_jacobians: of each.
    """
    found, least = [Bend()], float(np.nanmax([one.log_evidence for one in plain]))
    for (part, _), one, jacobian in zip(BENDS, straight, log_jacobians, strict=True):
        rise = one.log_evidence + jacobian - least
        if np.isfinite(rise) and np.isfinite(one.macro).all():
            found.append(Bend(1.0 + part, float(rise)))
    return max(found, key=lambda bend: bend.rise)
