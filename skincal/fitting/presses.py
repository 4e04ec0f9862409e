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

from skincal.fitting.problem import FitProblem
from skincal.fitting.residuals import Found, Presses, room_to_search, search
from skincal.fitting.seen import Images
from skincal.fitting.types import Floats, Ints
from skincal.model.press.jit import telling

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
    """Results of Gauss-Newton for n pairs of a macro draw and a press.

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
    free = np.full(3, np.inf)
    return _searched(problem, images, macro, sigmas, press, nuisance, free, 0, to_rest=False)


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
    centre: Floats | None = None,
    brief: bool = False,
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
        centre: (n, 2) slack about which each is scattered [m]; None for that of its press.
        brief: find nuisance, objective and Hessian alone; the rest stays empty.
    """
    bound = _bound(problem, room)
    return _searched(
        problem, images, macro, sigmas, press, start, bound, iterations,
        to_rest=to_rest, centre=centre, brief=brief,
    )  # fmt: skip


def _searched(
    problem: FitProblem,
    images: Images,
    macro: Floats,
    sigmas: Floats,
    press: Ints,
    start: Floats,
    bound: Floats,
    iterations: int,
    *,
    to_rest: bool,
    centre: Floats | None = None,
    brief: bool = False,
) -> PressStates:
    """See :func:`skincal.fitting.residuals.search`."""
    readings, shared = problem.observation, problem.shared
    count, taxels = len(press), problem.rig.layout.taxels
    link = readings.link
    known = Presses(
        np.column_stack([problem.across_m, problem.along_m, np.log(problem.force_n), problem.centre]),
        np.column_stack([problem.indenter, problem.rows]),
        np.array(
            [readings.target, readings.share, readings.signal, problem.used, problem.saturated], np.float64
        ),
        np.array([np.exp(shared.log_gain), readings.offset + shared.level]),
        np.array([link.values, link.mean, link.slope]),
    )
    if centre is not None:  # every pair is a press of its own
        known = known.scattered_about(press, centre)
        press = np.arange(count, dtype=np.intp)
    shapes = (3,), (), (3, 3), (2,), (taxels,), (taxels,), (taxels, 5), (taxels, 3), (taxels,)
    found = Found(*(np.empty((0 if brief and n > 2 else count, *shape)) for n, shape in enumerate(shapes)))
    given = _plain(macro), _plain(sigmas), _whole(press), _plain(start), bound
    tables = images.tables()
    with telling():
        search(tables, known, *given, _MAX_STEP, iterations, to_rest, found, room_to_search(tables, taxels))
    return PressStates(*found)


def _plain(values: Floats) -> Floats:
    """Values as the compiled search takes them: one after the other, and its own to write to."""
    return np.require(values, np.float64, ["C", "W"])


def _whole(values: Ints) -> Ints:
    return np.require(values, np.intp, ["C", "W"])


def _bound(problem: FitProblem, room: float) -> Floats:
    # Tables of the general way go no further than the declared slack.
    slack = problem.rig.slack_m * (room if problem.contacts is None else 1.0)
    return np.array([slack, slack, 0.5])


def solve_small(matrices: Floats, vectors: Floats) -> Floats:
    """Solves n small systems (n, d, d) for (n, d)."""
    return np.asarray(np.linalg.solve(matrices, vectors[..., None])[..., 0], dtype=np.float64)


def half_inverse(hessian: Floats) -> tuple[Floats, Floats]:
    """L (n, 3, 3) with L L' the inverses of positive matrices (n, 3, 3), and log|L| (n,)."""
    tiny = 1e-15
    c00 = np.sqrt(hessian[:, 0, 0])
    c10, c20 = hessian[:, 1, 0] / c00, hessian[:, 2, 0] / c00
    c11 = np.sqrt(np.maximum(hessian[:, 1, 1] - c10**2, tiny * hessian[:, 1, 1]))
    c21 = (hessian[:, 2, 1] - c20 * c10) / c11
    c22 = np.sqrt(np.maximum(hessian[:, 2, 2] - c20**2 - c21**2, tiny * hessian[:, 2, 2]))
    out = np.zeros_like(hessian)
    out[:, 0, 0], out[:, 1, 1], out[:, 2, 2] = 1.0 / c00, 1.0 / c11, 1.0 / c22
    out[:, 0, 1] = -c10 * out[:, 0, 0] * out[:, 1, 1]
    out[:, 1, 2] = -c21 * out[:, 1, 1] * out[:, 2, 2]
    out[:, 0, 2] = -(c20 * out[:, 0, 0] + c21 * out[:, 0, 1]) * out[:, 2, 2]
    return out, -np.log(c00 * c11 * c22)
