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
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from skincal.fitting.lookup import Tables
from skincal.fitting.problem import FitProblem
from skincal.fitting.residuals import Presses, room_to_search, search
from skincal.fitting.types import Floats, Ints
from skincal.model.press.jit import reporting_compilation

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

_EXACT_FORCE = 1e-7
"""Standard deviation of a force that is taken as measured: a numerical tolerance."""


def to_patch(across_m: Floats, along_m: Floats, alpha_rad: Floats) -> Floats:
    """Patch coordinates (n, 2) of offsets from the centre across and along (contract: the inverse of the turn)."""
    cos, sin = np.cos(alpha_rad), np.sin(alpha_rad)
    return np.stack([across_m * cos + along_m * sin, along_m * cos - across_m * sin], axis=-1)


def from_patch(uv_m: Floats, alpha_rad: Floats) -> Floats:
    """Offsets (n, 2) across and along of patch coordinates."""
    cos, sin = np.cos(alpha_rad), np.sin(alpha_rad)
    u, v = uv_m[..., 0], uv_m[..., 1]
    return np.stack([u * cos - v * sin, u * sin + v * cos], axis=-1)


@dataclass(frozen=True, eq=False)
class Places:
    """Possible places of presses: number of the press (N,), patch coordinates (N, 2) [m], force error (N,)."""

    press: Ints
    uv_m: Floats
    force_error: Floats


class PressStates(NamedTuple):
    """Results of Gauss-Newton for n pairs of a macro draw and a press.

    Attributes:
        press: (n,) number of the press.
        macro: (n, 5) macro variables in the order of ``MACRO``.
        sigmas: (n, 6) in the order of ``HYPER``, not their logarithms.
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

    press: Ints
    macro: Floats
    sigmas: Floats
    nuisance: Floats
    objective: Floats
    hessian: Floats
    uv_m: Floats
    residual: Floats
    simulated: Floats
    macro_slope: Floats
    nuisance_slope: Floats
    level_slope: Floats

    @property
    def places(self) -> Places:
        """Where the presses are."""
        return Places(self.press, self.uv_m.copy(), self.nuisance[:, 2].copy())

    def some(self, rows: Ints) -> PressStates:
        """Return some of the pairs, by their numbers."""
        return PressStates._make(array[rows] for array in self)


@dataclass(frozen=True, eq=False)
class PressModel:
    """Presses, and the simulated images that they are compared with.

    Attributes:
        problem: the presses.
        tables: load shares round the macro variables that are asked for.
    """

    problem: FitProblem
    tables: Tables

    def evaluate(self, macro: Floats, sigmas: Floats, press: Ints, nuisance: Floats) -> PressStates:
        """Objective, Hessian and slopes at given nuisance.

        Args:
            macro: (n, 5) macro variables in the order of ``MACRO``, or (5,) for all.
            sigmas: (n, 6) in the order of ``HYPER``, not their logarithms, or (6,) for all.
            press: (n,) number of the press.
            nuisance: (n, 3) slack and force error.
        """
        return self.settle(macro, sigmas, press, nuisance, iterations=0, to_rest=False)

    def settle(
        self,
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
        """Gauss-Newton over the nuisance of n pairs of a macro draw and a press; arguments as :meth:`evaluate`.

        Args:
            macro: (n, 5) or (5,) macro variables.
            sigmas: (n, 6) or (6,) in the order of ``HYPER``, not their logarithms.
            press: (n,) number of the press.
            start: (n, 3) nuisance to start from.
            iterations: full steps at most; with 0 nothing is bounded.
            to_rest: go on with smaller steps where the full ones did not come to rest.
            room: the slack is bounded at so many times what the rig declares.
            centre: (n, 2) slack about which each is scattered [m]; None for that of its press.
            brief: find nuisance, objective and Hessian alone; the rest stays empty.
        """
        # Tables of the general way go no further than the declared slack.
        slack = self.problem.rig.slack_m * (room if self.problem.contacts is None else 1.0)
        bound = np.array([slack, slack, 0.5]) if iterations else np.full(3, np.inf)
        count, taxels, known = len(press), self.problem.rig.layout.taxels, self._presses
        # The compiled search takes arrays that lie in one piece, and are its own to write to.
        macro = np.require(np.broadcast_to(macro, (count, 5)), np.float64, ["C", "W"])
        sigmas = np.require(np.broadcast_to(sigmas, (count, 6)), np.float64, ["C", "W"])
        start = np.require(start, np.float64, ["C", "W"])
        press = np.require(press, np.intp, ["C", "W"])
        own = press
        if centre is not None:  # every pair is a press of its own
            known, own = known.scattered_about(press, centre), np.arange(count, dtype=np.intp)
        shapes = (3,), (), (3, 3), (2,), (taxels,), (taxels,), (taxels, 5), (taxels, 3), (taxels,)
        empty = (np.empty((0 if brief and n > 2 else count, *shape)) for n, shape in enumerate(shapes))
        found = PressStates(press, macro, sigmas, *empty)
        room_for_work = room_to_search(self.tables, taxels)
        with reporting_compilation():
            search(
                self.tables, known, own, start, bound, _MAX_STEP, iterations, to_rest, found, room_for_work
            )
        return found

    def settle_at(
        self, places: Places, macro: Floats, sigmas: Floats, *, forces_known: bool = False, **how: Any
    ) -> PressStates:
        """Settle presses at their places (N,), seen from W macro points.

        Args:
            places: where each press could have been.
            macro: (W, 5) macro variables.
            sigmas: (W, 6) in the order of ``HYPER``, not their logarithms.
            forces_known: take the forces as measured.
            how: as for :meth:`settle`.

        Returns:
            W * N pairs, all places of a point one after the other.
        """
        spots = len(places.press)
        macro, sigmas = np.repeat(macro, spots, axis=0), np.repeat(sigmas, spots, axis=0)
        press = np.tile(places.press, len(macro) // spots)
        start = self.nuisance_at(places, macro)
        if forces_known:
            sigmas[:, 1], start[:, 2] = _EXACT_FORCE, 0.0
        return self.settle(macro, sigmas, press, start, **how)

    def bends(self, state: PressStates, steps: Floats) -> Floats:
        """Change (n, J, 3) of the slopes by nuisance from one step (n, 3) behind to one ahead."""
        ahead, behind = (
            self.evaluate(state.macro, state.sigmas, state.press, state.nuisance + side * steps)
            for side in (1, -1)
        )
        return ahead.nuisance_slope - behind.nuisance_slope

    def nuisance_at(self, places: Places, macro: Floats) -> Floats:
        """Nuisance (W * N, 3) that keeps presses at their places (N,) on the patch for macro variables (W * N, 5)."""
        count = len(macro) // len(places.press)
        press = np.tile(places.press, count)
        offset = from_patch(np.tile(places.uv_m, (count, 1)), macro[:, 2])
        across = offset[:, 0] + macro[:, 0] - self.problem.across_m[press]
        along = offset[:, 1] + macro[:, 1] - self.problem.along_m[press]
        return np.stack([across, along, np.tile(places.force_error, count)], axis=1)

    @cached_property
    def _presses(self) -> Presses:
        """The presses as the compiled search takes them."""
        problem, readings, shared = self.problem, self.problem.observation, self.problem.shared
        link = readings.link
        return Presses(
            np.column_stack([problem.across_m, problem.along_m, np.log(problem.force_n), shared.centre]),
            np.column_stack([problem.indenter, problem.rows]),
            np.array(
                [readings.target, readings.share, readings.signal, problem.used, problem.saturated],
                np.float64,
            ),
            np.array([np.exp(shared.log_gain), readings.offset + shared.level]),
            np.array([link.values, link.mean, link.slope]),
            np.array(readings.response, np.float64),
        )


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
