"""The joint fit of a session: sensor, effects and the place of every press at once, by damped Gauss-Newton steps.

The most probable hypothesis minimises

    sum (residual / sigma)² + sum_k (place_k / prior)² + sum (x_i / prior_i)²

over the five parameters of the base model, coordinates x of effects (:mod:`skincal.gap.free`) and three numbers of
every press. Presses hang together by the sensor only, so their numbers are eliminated press by press (a Schur
complement), and a step costs little more than the model itself. Presses that are not learned from have no say in the
sensor; they only find their own place.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass, replace

import numpy as np

from skincal.gap.downhill import DAMPING, damped, uphill
from skincal.gap.free import Coordinate, clipped
from skincal.gap.hypothesis import Hypothesis, Parameters
from skincal.gap.problem import Look, RefitOptions, RefitProblem, Slopes
from skincal.gap.reading import Reading
from skincal.inference.session import GapSession
from skincal.model import SensorPose
from skincal.model.arrays import BoolArray, FloatArray

_TRIES, _OWN_TRIES = 6, 2
"""A step is tried so often, where it leads uphill: with those presses damped that are to blame, so many times; after
that, or where none is, shorter as a whole."""


@dataclass(frozen=True, eq=False)
class Refit:
    """What a refit found.

    Attributes:
        hypothesis: the most probable one.
        x: (n,) coordinates of the effects.
        slopes: there.
        objective: the sum that was minimised, over the observations that were learned from.
        covariance: (5 + n, 5 + n) of base parameters and coordinates, places integrated out.
    """

    hypothesis: Hypothesis
    x: FloatArray
    slopes: Slopes
    objective: float
    covariance: FloatArray


def refit(
    start: Hypothesis,
    session: GapSession,
    reading: Reading,
    options: RefitOptions,
    coords: Sequence[Coordinate] = (),
    x: FloatArray | None = None,
    learn: BoolArray | None = None,
    fixed: Mapping[str, Parameters] | None = None,
) -> Refit:
    """Finds the most probable hypothesis near a start.

    Args:
        start: sensor and places; its effects are not looked at.
        session: what was pressed.
        reading: what was read.
        options: priors and limits.
        coords: numbers of effects to be found.
        x: (n,) where they start; zero if not given.
        learn: (N,) observations that sensor and effects are learned from; None: all of them.
        fixed: parameters that stay as they are, of effects without free numbers or beside them.
    """
    problem = RefitProblem(session, reading, options, tuple(coords), learn, dict(fixed or {}))
    x = np.zeros(len(coords)) if x is None else clipped(coords, x)
    ended: list[tuple[Look, Slopes, float]] = []

    def make() -> Mapping[str, FloatArray]:
        ended.append(_descended(problem, start, x))
        return _numbers(ended[0][0])

    parts = [start.model, start.places, session, reading, options, problem.coords, x, learn, problem.fixed]
    kept = options.keep("refit", parts, make)
    here, slopes, best = ended[0] if ended else _again(problem, start, kept)
    covariance = problem.covariance(here.hypothesis, slopes)
    return Refit(here.hypothesis, here.x, slopes, best, covariance)


def _descended(problem: RefitProblem, start: Hypothesis, x: FloatArray) -> tuple[Look, Slopes, float]:
    """Where the way downhill ends, the slopes there, and the objective."""
    options = problem.options
    here = problem.look(start, x)
    whole = problem.wants_base(0)
    slopes = problem.slopes(here, base=whole)
    best, costs = problem.judged(here)
    own = np.zeros(len(start.places))
    for step in range(options.steps):
        there, value, after, own = _tried(problem, here, slopes, best, costs, own, step)
        if not _taken(value, best, settling=step < options.settle):
            break
        fall, here, best, costs = best - value, there, value, after
        found = step > options.settle and fall < options.enough
        whole = found or problem.wants_base(step + 1)
        slopes = problem.slopes(here, base=whole)
        if found:
            break
    return here, slopes if whole else problem.slopes(here), best


def _numbers(end: Look) -> dict[str, FloatArray]:
    """All that tells where a fit ended."""
    model = end.hypothesis.model
    return {
        "pose": np.array(astuple(model.pose)),
        "elasticity": np.array(model.elasticity_pa_per_m),
        "scale": np.array(model.scale_per_n),
        "places": end.hypothesis.places,
        "x": end.x,
    }


def _again(
    problem: RefitProblem, start: Hypothesis, numbers: Mapping[str, FloatArray]
) -> tuple[Look, Slopes, float]:
    """What :func:`_descended` found, from the numbers of its end."""
    scale = numbers["scale"]
    model = replace(
        start.model,
        pose=SensorPose(*numbers["pose"].tolist()),
        elasticity_pa_per_m=float(numbers["elasticity"]),
        scale_per_n=scale if scale.ndim else float(scale),
    )
    here = problem.look(replace(start, model=model, places=numbers["places"]), numbers["x"])
    return here, problem.slopes(here), problem.judged(here)[0]


def _tried(
    problem: RefitProblem,
    here: Look,
    slopes: Slopes,
    best: float,
    costs: FloatArray,
    own: FloatArray,
    step: int,
) -> tuple[Look, float, FloatArray, FloatArray]:
    """A step that lowers the objective, or the last one that was tried.

    Args:
        problem: what is minimised.
        here: where the step begins.
        slopes: there.
        best: the objective there.
        costs: (P,) what each press adds of it.
        own: (P,) damping of each press to begin with.
        step: how many there were. One in which only presses move is taken as it comes.

    Returns:
        Where it leads, the objective and the costs (P,) there, and the damping (P,) for the next step.
    """
    settling = step < problem.options.settle
    free, share, tries = problem.options.base and not settling, 1.0, 0
    while True:
        damping = np.maximum(own, DAMPING if settling else 0.0)
        proposal = problem.step(here, slopes, damping, free=free)
        there = problem.moved(here, *(share * part for part in proposal))
        value, after = problem.judged(there)
        # One press that jumps over its valley must not keep the others from going on.
        wrong = uphill(costs, after)
        own = damped(own, wrong)
        tries += 1
        if _taken(value, best, settling=settling) or tries == _TRIES:
            return there, value, after, own
        share = 1.0 if wrong.any() and tries <= _OWN_TRIES else share / 3


def _taken(value: float, best: float, *, settling: bool) -> bool:
    """Whether a step is taken; where a press has no image, and the objective is no number, any is."""
    return not np.isfinite(best) or bool(np.isfinite(value) and (settling or value <= best))
