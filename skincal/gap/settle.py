"""Every press at its best place, the sensor as it is: downhill from where it is.

A step that leads a press uphill is taken back. Where presses remember others, as with creep over long times, what is
taken back changes what others feel, and one of them may end a little higher all the same.
"""

from __future__ import annotations

import numpy as np

from skincal.gap.downhill import DAMPING, damped, uphill
from skincal.gap.hypothesis import Hypothesis
from skincal.gap.problem import BASE_SIZE, RefitOptions, RefitProblem
from skincal.gap.reading import Reading
from skincal.inference.session import GapSession
from skincal.model.arrays import FloatArray


def settled(
    start: Hypothesis, session: GapSession, reading: Reading, options: RefitOptions, steps: int
) -> tuple[Hypothesis, FloatArray]:
    """The hypothesis with every press moved to where it fits best, and what it leaves (N, J), whitened.

    Args:
        start: sensor and effects stay as they are.
        session: what was pressed.
        reading: what was read.
        options: priors of places.
        steps: of every press.
    """
    problem = RefitProblem(session, reading, options, (), None, start.effects)
    here = problem.look(start, np.zeros(0))
    costs = problem.judged(here)[1]
    own = np.full(len(start.places), DAMPING)
    for _ in range(steps):
        slopes = problem.slopes(here, base=False)
        places = problem.step(here, slopes, own, free=False)[2]
        there = problem.moved(here, np.zeros(BASE_SIZE), np.zeros(0), places)
        after = problem.judged(there)[1]
        wrong = uphill(costs, after)
        if wrong.any():
            places[wrong] = 0.0
            there = problem.moved(here, np.zeros(BASE_SIZE), np.zeros(0), places)
            after = problem.judged(there)[1]
        own = np.maximum(damped(own, wrong), DAMPING)
        here, costs = there, after
    return here.hypothesis, reading.residual(here.values)
