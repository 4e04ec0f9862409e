"""The micro variables: each press's contact position within its slack, on normalised images.

The information on the position lies in the ratios of the taxel values (paper, section III-B). For one press
with observed image D, simulated shares g and the free amplitude c of the normalisation, the objective is

    Q(delta) = |D|^2 (1 - cos^2 angle(D, g(delta))) / sigma^2  +  |delta|^2 / sigma_p^2,    |delta_i| <= slack

The first term is the squared distance of the normalised images, in units of the noise of an image of the size
of D. The second is the prior of the measured position. With ``sigma_p`` infinite the objective is the
paper's.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import nlopt  # pyright: ignore[reportMissingTypeStubs]
import numpy as np

from skincal.fitting.lattice import square
from skincal.fitting.types import Floats

_TINY = 1e-12
"""Least power of an image, against division by zero."""

_TOLERANCE_M = 1e-6
"""Tolerance of the position [m]; its effect on the loss is far below the noise."""

_DIFFERENCE_M = 5e-6
"""Step of the central differences [m]."""
_CROSS = _DIFFERENCE_M * np.array([[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
"""Points of the central differences: the centre, and a step to each side along both axes [m]."""

_GIVES_UP: Any = (
    RuntimeError,
    nlopt.RoundoffLimited,  # pyright: ignore
    getattr(nlopt, "runtime_error", RuntimeError),
)
"""Exceptions by which nlopt reports that it cannot improve further, by version."""


@dataclass(frozen=True)
class MicroSettings:
    """Weights of image residual and slack.

    Attributes:
        sigma_counts: standard deviation of an image residual [counts].
        position_sigma_m: standard deviation of the measured contact position [m]; inf for no prior.
        slack_m: bound of the slack along each direction [m].
    """

    sigma_counts: float
    position_sigma_m: float
    slack_m: float

    @property
    def stiffness(self) -> float:
        """1 / sigma_p^2 [1/m²]."""
        return 1.0 / self.position_sigma_m**2 if np.isfinite(self.position_sigma_m) else 0.0


def image_mismatch(observed: Floats, shares: Floats) -> Floats:
    """Return |D|^2 (1 - cos^2) (n,) [counts²] of observed (n, J) and simulated (n, J) images of any scale."""
    power = np.einsum("nj,nj->n", shares, shares)
    product = np.maximum(np.einsum("nj,nj->n", shares, observed), 0.0)
    total = np.einsum("nj,nj->n", observed, observed)
    return total - np.where(power > _TINY, product**2 / np.maximum(power, _TINY), 0.0)


def nlopt_micro(
    observed: Floats, images: Callable[[Floats], Floats], settings: MicroSettings, start_m: Floats
) -> tuple[Floats, float]:
    """One micro problem with nlopt, for any geometry (SLSQP, Kraft 1994, with slopes by differences).

    Args:
        observed: (J,) observed image [counts].
        images: takes slacks (m, 2) [m] to simulated loads (m, J) of any scale.
        settings: noise, stiffness of the slack, bounds.
        start_m: (2,) slack to start from [m].

    Returns:
        Slack (2,) [m] and objective there: the best that was seen.
    """
    best, best_q = np.zeros(2), np.inf

    def objective(slack_mm: Floats, gradient: Floats) -> float:
        nonlocal best, best_q
        slack = np.asarray(slack_mm, dtype=np.float64) * 1e-3
        at = slack + (_CROSS if gradient.size else _CROSS[:1])
        q = micro_objective(observed[None], images(at), at, settings)
        if q[0] < best_q:
            best, best_q = slack, float(q[0])
        if gradient.size:
            gradient[:] = (q[[1, 3]] - q[[2, 4]]) / (2e3 * _DIFFERENCE_M)
        return float(q[0])

    bound = settings.slack_m * 1e3
    if bound <= 0:
        return best, objective(best, np.empty(0))
    solver: Any = nlopt.opt(nlopt.LD_SLSQP, 2)  # pyright: ignore
    solver.set_lower_bounds(-bound)
    solver.set_upper_bounds(bound)
    solver.set_min_objective(objective)
    solver.set_xtol_abs(_TOLERANCE_M * 1e3)
    solver.set_maxeval(200)
    # If the objective is flat to rounding, nlopt raises an error; the best position seen is still valid.
    with suppress(*_GIVES_UP):
        solver.optimize(np.clip(start_m * 1e3, -bound, bound))
    return best, best_q


def micro_objective(observed: Floats, shares: Floats, slack_m: Floats, settings: MicroSettings) -> Floats:
    """Return Q (n,) of observed (n, J) and simulated images (n, J) of any scale, at slacks (n, 2) [m]."""
    observed = np.broadcast_to(observed, shares.shape)
    mismatch = image_mismatch(observed, shares) / settings.sigma_counts**2
    return mismatch + settings.stiffness * (slack_m**2).sum(axis=-1)


def slack_lattice(half_m: float) -> Floats:
    """Return a square lattice (N, 2) of slacks up to ``half_m`` [m].

    Its step is at most 0.5 mm, unless that takes more than 17 nodes per side.
    """
    side = min(2 * int(np.ceil(half_m / 0.5e-3 - 1e-9)) + 1, 17)
    return square(np.linspace(-half_m, half_m, side))
