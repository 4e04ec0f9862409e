"""What the likelihood asks of simulated images, whichever way they are made."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from skincal.fitting.problem import FitProblem
from skincal.fitting.types import Floats, Ints


@dataclass(frozen=True, eq=False)
class Seen:
    """Load shares of n presses, and how they change with what is sought.

    Attributes:
        uv_m: (n, 2) contact positions in patch coordinates [m].
        value: (n, J) share of the normal force that each taxel reports.
        by_contact: (n, J, 2) derivative by the contact's position across and along [1/m].
        by_centre: (n, J, 2) the same by the position of the sensor's centre.
        by_alpha: (n, J) derivative by the turn, contact and centre held [1/rad].
        by_log_ratio: (n, J) derivative by log(F/E).
    """

    uv_m: Floats
    value: Floats
    by_contact: Floats
    by_centre: Floats
    by_alpha: Floats
    by_log_ratio: Floats


class Images(Protocol):
    """Simulated images round some macro variables."""

    def see(self, problem: FitProblem, macro: Floats, press: Ints, nuisance: Floats) -> Seen:
        """Load shares of n presses.

        Args:
            problem: the presses.
            macro: (n, 5) centre across and along [m], turn [rad], log E, log S.
            press: (n,) number of the press.
            nuisance: (n, 3) slack across and along [m], log of the true over the measured force.
        """
        ...


def offsets(
    problem: FitProblem, macro: Floats, press: Ints, nuisance: Floats
) -> tuple[Floats, Floats, Floats]:
    """Where presses lie from the sensor's centre, across and along (n,) [m], and their log(F/E) (n,)."""
    across = problem.across_m[press] + nuisance[:, 0] - macro[:, 0]
    along = problem.along_m[press] + nuisance[:, 1] - macro[:, 1]
    return across, along, np.log(problem.force_n[press]) + nuisance[:, 2] - macro[:, 3]


def to_patch(across_m: Floats, along_m: Floats, alpha_rad: Floats) -> Floats:
    """Patch coordinates (n, 2) of offsets from the centre across and along (contract: the inverse of the turn)."""
    cos, sin = np.cos(alpha_rad), np.sin(alpha_rad)
    return np.stack([across_m * cos + along_m * sin, along_m * cos - across_m * sin], axis=-1)


def from_patch(uv_m: Floats, alpha_rad: Floats) -> Floats:
    """Offsets (n, 2) across and along of patch coordinates."""
    cos, sin = np.cos(alpha_rad), np.sin(alpha_rad)
    u, v = uv_m[..., 0], uv_m[..., 1]
    return np.stack([u * cos - v * sin, u * sin + v * cos], axis=-1)


def turned_slopes(by_u: Floats, by_v: Floats, alpha_rad: Floats) -> Floats:
    """Derivatives (n, J, 2) across and along, of derivatives by u and v (n, J)."""
    cos, sin = np.cos(alpha_rad)[:, None], np.sin(alpha_rad)[:, None]
    return np.stack([cos * by_u - sin * by_v, sin * by_u + cos * by_v], axis=-1)
