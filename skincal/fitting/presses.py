"""The nuisance of every press, on absolute images: where it really was, and what its force really was.

For macro variables m = (centre across, centre along, alpha, log E, log S) a press k has the slack delta (2), and the
relative error f of its force (1). Its objective is

    Q_k = sum_j (y_kj - c(S_j F_k e^f phi_j + rest_j))^2 / sd_kj^2 + |delta - B_k b|^2 / sigma_p^2 + f^2 / sigma_f^2

with c the converter's mean and sd as in :mod:`skincal.fitting.readings`, gains, levels at rest and the field b of
:mod:`skincal.fitting.shared` held. All three are found at once by Gauss-Newton; the Hessian H of Q/2 there gives
Laplace's approximation of the integral over them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skincal.fitting.problem import FitProblem
from skincal.fitting.residuals import add_up
from skincal.fitting.seen import Images
from skincal.fitting.types import Floats, Ints

MACRO = ("across_m", "y_m", "alpha_rad", "log_elasticity", "log_scale")
HYPER = (
    "log_position_sigma", "log_force_sigma", "log_noise_sigma", "log_misfit", "log_gain_sigma", "log_field_sigma",
)  # fmt: skip
"""Scatter of positions [m], forces, hold means [counts]; relative misfit tau; spread of gains; smooth error [m]."""

SLACK_ROOM = 1.5
"""Slack is bounded at so many times what the rig declares, as the pose takes up the mean error of the positions.

With a bound at the declared slack itself the presses that lie there would pull the pose, and make it too sharp.
"""

_MAX_STEP = np.array([0.4e-3, 0.4e-3, 0.05])


@dataclass(frozen=True, eq=False)
class PressStates:
    """What Gauss-Newton found for n pairs of a macro draw and a press.

    Attributes:
        nuisance: (n, 3) slack across, slack along [m], log of the true over the measured force.
        objective: (n,) Q.
        hessian: (n, 3, 3) of Q / 2.
        uv_m: (n, 2) contact position in patch coordinates [m].
        residual: (n, J) expected minus observed counts, over their standard deviation.
        simulated: (n, J) simulated values above rest [counts].
        macro_slope: (n, J, 5) derivative of the residual by the macro variables; that by log S is that by a log gain.
        nuisance_slope: (n, J, 3) the same by slack and force.
        level_slope: (n, J) the same by the level at rest.
    """

    nuisance: Floats
    objective: Floats
    hessian: Floats
    uv_m: Floats
    residual: Floats
    simulated: Floats
    macro_slope: Floats
    nuisance_slope: Floats
    level_slope: Floats


def evaluate(
    problem: FitProblem, images: Images, macro: Floats, sigmas: Floats, press: Ints, nuisance: Floats
) -> PressStates:
    """Objective, Hessian and slopes at given nuisance.

    Args:
        problem: the presses.
        images: simulated images round the macro draws.
        macro: (n, 5) macro variables in the order of ``MACRO``.
        sigmas: (n, 6) in the order of ``HYPER``, not their logarithms.
        press: (n,) number of the press.
        nuisance: (n, 3) slack and force error.
    """
    got = images.see(problem, macro, press, nuisance)
    readings, shared, count, taxels = (
        problem.observation,
        problem.shared,
        len(press),
        problem.rig.layout.taxels,
    )
    state = PressStates(
        nuisance,
        np.empty(count),
        np.empty((count, 3, 3)),
        got.uv_m,
        np.empty((count, taxels)),
        np.empty((count, taxels)),
        np.empty((count, taxels, 5)),
        np.empty((count, taxels, 3)),
        np.empty((count, taxels)),
    )
    link = readings.link
    add_up(
        (got.value, got.by_contact, got.by_centre, got.by_alpha, got.by_log_ratio),
        np.exp(macro[:, 4] + nuisance[:, 2]) * problem.force_n[press],
        np.exp(shared.log_gain),
        readings.offset + shared.level,
        (readings.target, readings.share, readings.signal, problem.used, problem.saturated),
        (link.values, link.mean, link.slope),
        press,
        sigmas,
        nuisance - problem.centre[press],
        (state.objective, state.hessian, state.residual, state.simulated),
        (state.macro_slope, state.nuisance_slope, state.level_slope),
    )
    return state


def settle(
    problem: FitProblem,
    images: Images,
    macro: Floats,
    sigmas: Floats,
    press: Ints,
    start: Floats,
    *,
    iterations: int = 4,
    to_rest: bool = True,
    room: float = SLACK_ROOM,
) -> PressStates:
    """Gauss-Newton over the nuisance of n pairs of a macro draw and a press; arguments as :func:`evaluate`.

    Args:
        problem: the presses.
        images: simulated images round the macro draws.
        macro: (n, 5) macro variables.
        sigmas: (n, 6) in the order of ``HYPER``, not their logarithms.
        press: (n,) number of the press.
        start: (n, 3) nuisance to start from.
        iterations: full steps at most.
        to_rest: go on with smaller steps where the full ones did not come to rest.
        room: the slack is bounded at so many times what the rig declares.
    """
    bound = _bound(problem, room)
    state = evaluate(problem, images, macro, sigmas, press, np.clip(start, -bound, bound))
    now, rows = state, np.arange(len(press))
    for number in range(iterations):
        # Full steps, not only downhill ones: the images hold a press on a thin curved sheet, and a step along it
        # first leaves the sheet and is brought back by the next. The best point seen is kept.
        trial = np.clip(
            now.nuisance + _step(problem, now, press[rows], sigmas[rows], 1e-6 if number < 6 else 1e-2),
            -bound,
            bound,
        )
        moving = (np.abs(trial - now.nuisance) / _MAX_STEP).max(axis=1) > 2e-4
        rows = rows[moving]
        if not len(rows):
            break
        now = evaluate(problem, images, macro[rows], sigmas[rows], press[rows], trial[moving])
        better = now.objective < state.objective[rows]
        _store(state, now, rows[better], better)
    if to_rest and len(rows):
        _descend(problem, images, macro, sigmas, press, state, rows, bound)
    return state


def _descend(
    problem: FitProblem,
    images: Images,
    macro: Floats,
    sigmas: Floats,
    press: Ints,
    state: PressStates,
    rows: Ints,
    bound: Floats,
    iterations: int = 6,
) -> None:
    """Levenberg's steps, downhill only, for the rows that Gauss-Newton has not brought to rest.

    Where the measured value is beyond what any place reaches, the residual does not vanish, and full steps go to and
    fro across the place.
    """
    damping = np.full(len(rows), 0.3)
    for _ in range(iterations):
        here = PressStates(*(array[rows] for array in vars(state).values()))
        step = _step(problem, here, press[rows], sigmas[rows], damping[:, None])
        moving = (np.abs(step) / _MAX_STEP).max(axis=1) > 2e-4
        if not moving.any():
            return
        rows, damping = rows[moving], damping[moving]
        trial = np.clip(here.nuisance[moving] + step[moving], -bound, bound)
        got = evaluate(problem, images, macro[rows], sigmas[rows], press[rows], trial)
        better = got.objective < state.objective[rows]
        _store(state, got, rows[better], better)
        damping *= np.where(better, 0.2, 6.0)


def _bound(problem: FitProblem, room: float) -> Floats:
    # Tables of the general way go no further than the declared slack.
    slack = problem.rig.slack_m * (room if problem.contacts is None else 1.0)
    return np.array([slack, slack, 0.5])


def _step(
    problem: FitProblem, state: PressStates, press: Ints, sigmas: Floats, damping: float | Floats
) -> Floats:
    prior = 1.0 / sigmas[:, [0, 0, 1]] ** 2
    gradient = np.einsum("njd,nj->nd", state.nuisance_slope, state.residual)
    gradient += prior * (state.nuisance - problem.centre[press])
    damped = state.hessian.copy()
    damped[:, [0, 1, 2], [0, 1, 2]] *= 1.0 + damping
    return np.clip(-solve_small(damped, gradient), -_MAX_STEP, _MAX_STEP)


def solve_small(matrices: Floats, vectors: Floats) -> Floats:
    """Solves n small systems (n, d, d) for (n, d)."""
    return np.asarray(np.linalg.solve(matrices, vectors[..., None])[..., 0], dtype=np.float64)


def _store(state: PressStates, got: PressStates, rows: Ints, which: NDArray[np.bool_]) -> None:
    """Overwrites rows of a state that :func:`settle` owns."""
    for old, new in zip(vars(state).values(), vars(got).values(), strict=True):
        old[rows] = new[which]
