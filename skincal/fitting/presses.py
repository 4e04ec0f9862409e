"""The nuisance parameters of every press, on absolute images: its true position and its true force.

For macro variables m = (centre across, centre along, alpha, log E, log S), press k has a slack delta (2) and
a relative force error f (1). Its objective is

    Q_k = sum_j (y_kj - c(S_j F_k e^f phi_j + rest_j))^2 / sd_kj^2 + |delta - B_k b|^2 / sigma_p^2 + f^2 / sigma_f^2

with c the converter's mean and sd as in :mod:`skincal.fitting.readings`. Gains, rest levels and the field b
of :mod:`skincal.fitting.shared` are held fixed. Gauss-Newton finds all three at once. The Hessian H of Q/2
there gives the Laplace approximation of the integral over them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from skincal.fitting.lookup import Tables
from skincal.fitting.problem import FitProblem
from skincal.fitting.residuals import Presses, allocate_workspace, search
from skincal.fitting.types import Floats, Ints
from skincal.model.press.jit import reporting_compilation

MACRO = ("across_m", "y_m", "alpha_rad", "log_elasticity", "log_scale")
"""Names of the macro variables, in the order of every array of them."""
HYPER = (
    "log_position_sigma", "log_force_sigma", "log_noise_sigma", "log_misfit", "log_gain_sigma", "log_field_sigma",
)  # fmt: skip
"""Names of the sigmas: scatter of positions [m], forces, hold means [counts]; relative misfit tau; spread of
gains; smooth position error [m]."""

SLACK_FACTOR = 1.5
"""The slack is bounded at this multiple of the declared one, as the pose absorbs the mean error of the positions.

With the declared slack itself as bound, presses at the bound would bias the pose and make its interval too
narrow."""

_MAX_STEP = np.array([0.4e-3, 0.4e-3, 0.05])
"""Longest step of slack [m] and log force."""

_EXACT_FORCE = 1e-7
"""Standard deviation of a force that is taken as measured: a numerical tolerance."""


def to_patch(across_m: Floats, along_m: Floats, alpha_rad: Floats) -> Floats:
    """Return patch coordinates (n, 2) of offsets from the centre across and along (contract: the inverse rotation)."""
    cos, sin = np.cos(alpha_rad), np.sin(alpha_rad)
    return np.stack([across_m * cos + along_m * sin, along_m * cos - across_m * sin], axis=-1)


def from_patch(uv_m: Floats, alpha_rad: Floats) -> Floats:
    """Return offsets (n, 2) across and along of patch coordinates."""
    cos, sin = np.cos(alpha_rad), np.sin(alpha_rad)
    u, v = uv_m[..., 0], uv_m[..., 1]
    return np.stack([u * cos - v * sin, u * sin + v * cos], axis=-1)


@dataclass(frozen=True, eq=False)
class Places:
    """Possible contact positions: press (N,), patch coordinates (N, 2) [m], log force error (N,)."""

    press: Ints
    uv_m: Floats
    force_error: Floats


class PressStates(NamedTuple):
    """Nuisance estimates for n pairs of a macro draw and a press.

    Attributes:
        press: (n,) number of the press.
        macro: (n, 5) macro variables in the order of ``MACRO``.
        sigmas: (n, 6) in the order of ``HYPER``, not their logarithms.
        nuisance: (n, 3) slack across, slack along [m], log of true over measured force.
        objective: (n,) Q.
        hessian: (n, 3, 3) of Q / 2.
        uv_m: (n, 2) contact position in patch coordinates [m].
        residual: (n, J) expected minus observed counts, over their standard deviation.
        simulated: (n, J) simulated values above rest [counts].
        macro_slope: (n, J, 5) derivative of the residual by the macro variables; that by log S equals that by
            a log gain.
        nuisance_slope: (n, J, 3) the same by slack and force.
        level_slope: (n, J) the same by the rest level.
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
        """The contact positions."""
        return Places(self.press, self.uv_m.copy(), self.nuisance[:, 2].copy())

    def take(self, rows: Ints) -> PressStates:
        """Return some of the pairs, by their numbers."""
        return PressStates._make(array[rows] for array in self)


@dataclass(frozen=True, eq=False)
class PressModel:
    """Presses, and the tables that simulate their images.

    Attributes:
        problem: the presses.
        tables: load shares around the macro variables in question.
    """

    problem: FitProblem
    tables: Tables

    def evaluate(self, macro: Floats, sigmas: Floats, press: Ints, nuisance: Floats) -> PressStates:
        """Evaluate objective, Hessian and slopes at nuisance (n, 3); other arguments as for :meth:`fit_nuisance`."""
        return self.fit_nuisance(macro, sigmas, press, nuisance, iterations=0, to_rest=False)

    def fit_nuisance(
        self,
        macro: Floats,
        sigmas: Floats,
        press: Ints,
        start: Floats,
        *,
        iterations: int = 4,
        to_rest: bool = True,
        slack_factor: float = SLACK_FACTOR,
        centre: Floats | None = None,
        brief: bool = False,
    ) -> PressStates:
        """Run Gauss-Newton over the nuisance of n pairs of a macro draw and a press.

        Args:
            macro: (n, 5) or (5,) macro variables.
            sigmas: (n, 6) or (6,) in the order of ``HYPER``, not their logarithms.
            press: (n,) number of the press.
            start: (n, 3) nuisance to start from.
            iterations: most full steps; with 0 the nuisance is not bounded.
            to_rest: whether damped steps follow if the full ones did not converge.
            slack_factor: the slack is bounded at this multiple of the declared one.
            centre: (n, 2) prior mean of the slack [m]; None for that of the press.
            brief: whether to fill nuisance, objective and Hessian only; the rest stays empty.
        """
        # Image tables of the general way only cover the declared slack.
        slack = self.problem.rig.slack_m * (slack_factor if self.problem.contacts is None else 1.0)
        bound = np.array([slack, slack, 0.5]) if iterations else np.full(3, np.inf)
        count, taxels, known = len(press), self.problem.rig.layout.taxels, self._presses
        # The compiled search needs contiguous, writable arrays.
        macro = np.require(np.broadcast_to(macro, (count, 5)), np.float64, ["C", "W"])
        sigmas = np.require(np.broadcast_to(sigmas, (count, 6)), np.float64, ["C", "W"])
        start = np.require(start, np.float64, ["C", "W"])
        press = np.require(press, np.intp, ["C", "W"])
        own = press
        if centre is not None:  # every pair counts as a press of its own
            known, own = known.scattered_about(press, centre), np.arange(count, dtype=np.intp)
        shapes = (3,), (), (3, 3), (2,), (taxels,), (taxels,), (taxels, 5), (taxels, 3), (taxels,)
        empty = (np.empty((0 if brief and n > 2 else count, *shape)) for n, shape in enumerate(shapes))
        found = PressStates(press, macro, sigmas, *empty)
        workspace = allocate_workspace(self.tables, taxels)
        with reporting_compilation():
            search(self.tables, known, own, start, bound, _MAX_STEP, iterations, to_rest, found, workspace)
        return found

    def fit_at_places(
        self, places: Places, macro: Floats, sigmas: Floats, *, forces_known: bool = False, **how: Any
    ) -> PressStates:
        """Estimate the nuisance of presses from their possible positions (N,), for W macro points.

        ``macro`` is (W, 5) and ``sigmas`` (W, 6), ``forces_known`` takes the forces as measured, and ``how`` is as for
        :meth:`fit_nuisance`. The result has W * N pairs, all positions of one macro point after another.
        """
        spots = len(places.press)
        macro, sigmas = np.repeat(macro, spots, axis=0), np.repeat(sigmas, spots, axis=0)
        press = np.tile(places.press, len(macro) // spots)
        start = self.nuisance_at(places, macro)
        if forces_known:
            sigmas[:, 1], start[:, 2] = _EXACT_FORCE, 0.0
        return self.fit_nuisance(macro, sigmas, press, start, **how)

    def bends(self, state: PressStates, steps: Floats) -> Floats:
        """Return the change (n, J, 3) of the nuisance slopes from one step (n, 3) behind to one step ahead."""
        ahead, behind = (
            self.evaluate(state.macro, state.sigmas, state.press, state.nuisance + side * steps)
            for side in (1, -1)
        )
        return ahead.nuisance_slope - behind.nuisance_slope

    def nuisance_at(self, places: Places, macro: Floats) -> Floats:
        """Return the nuisance (W * N, 3) that keeps presses at their positions (N,) on the patch.

        The macro variables (W * N, 5) are repeated for every position.
        """
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
    """Solve n small systems (n, d, d) for (n, d)."""
    return np.asarray(np.linalg.solve(matrices, vectors[..., None])[..., 0], dtype=np.float64)


def factor_inverse(hessian: Floats) -> tuple[Floats, Floats]:
    """Return L (n, 3, 3) with L L' the inverse of positive definite matrices (n, 3, 3), and log|L| (n,)."""
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
