"""Results of a fit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from skincal.fitting.alternatives import Nonlinearity
from skincal.fitting.fit_options import SearchBox
from skincal.fitting.grid import MacroGrid
from skincal.fitting.problem import FitProblem
from skincal.fitting.types import Bools, Floats

PARAMETERS = ("across_m", "y_m", "alpha_rad", "elasticity_pa_per_m", "scale_per_n")
"""The macro variables in the order of every array of them: pose, elasticity E [Pa/m], scale S [1/N]."""

FEWEST_DRAWS = 20
"""With a smaller effective sample size, the draws do not show the width of the valley."""

ONE_PLACE = 0.25
"""Presses within this fraction of the patch count as one place."""

POSE = ("across_m", "y_m", "alpha_rad")
"""Names of the pose parameters."""

OPEN = (-np.inf, np.inf)
"""Interval of a parameter that the data do not bound."""


@dataclass(frozen=True)
class FitFinding:
    """A finding of a fit, with advice for the user."""

    code: str
    severity: Literal["info", "warning"]
    text: str
    advice: str = ""


@dataclass(frozen=True, eq=False)
class GridResult:
    """The evaluated grid; arrays are (A, E, X, Y) over turns, elasticities, positions across and along.

    Attributes:
        grid: the values of the macro variables.
        mse_counts2, scale_per_n, slack_rms_m: as in :class:`skincal.fitting.grid.GridSlab`.
        in_valley: combinations whose loss is within a fixed bound; none if the noise bounds the valley, as
            the posterior uses absolute images and does not bound this loss.
        mse_at_best_counts2: the same loss at the best point of the fit, between the grid's values [counts²].
    """

    grid: MacroGrid
    mse_counts2: Floats
    scale_per_n: Floats
    slack_rms_m: Floats
    in_valley: Bools
    mse_at_best_counts2: float


@dataclass(frozen=True, eq=False)
class PressFit:
    """The presses at the best point, in the order of the problem's presses (K).

    Attributes:
        slack_m: (K, 2) estimated minus measured contact position, across and along [m].
        uv_m: (K, 2) estimated contact position in patch coordinates [m].
        observed: (K, J) observed values above rest, unclipped [counts].
        simulated: (K, J) simulated values [counts].
        rmse_counts: (K,) root mean square difference over the taxels [counts].
        good: (K,) whether the difference is as small as the noise allows.
        force_off: (K,) log of the force that fits the image best over the measured one.
    """

    slack_m: Floats
    uv_m: Floats
    observed: Floats
    simulated: Floats
    rmse_counts: Floats
    good: Bools
    force_off: Floats


@dataclass(frozen=True)
class Sigmas:
    """Estimated uncertainties of the rig and the sensor, one standard deviation each.

    Attributes:
        position_m: of a measured position, apart from the shared error [m].
        force: of a measured force, relative.
        noise_counts: of a hold mean [counts].
        misfit: of a reading, relative to its signal, beyond its noise.
        gain: of the taxels' scales, relative.
        field_m: of the smooth error that positions share [m].
    """

    position_m: float
    force: float
    noise_counts: float
    misfit: float
    gain: float
    field_m: float


@dataclass(frozen=True, eq=False)
class FitResult:
    """Result of a fit.

    Attributes:
        best: macro variables of the best point, by the names of ``PARAMETERS``.
        intervals: low and high of each; (-inf, inf) if the data do not bound it.
        mse_counts2: loss at the best point, positions placed within their slack by the absolute images [counts²].
        valley_mse_counts2: bound of the valley [counts²]: of that same loss if the noise bounds it; of the
            grid's if the bound is fixed.
        bound: origin of the bound.
        draws: (N, 5) draws from the valley, in the order of ``PARAMETERS``.
        sigmas: estimated scatter of positions, forces and images.
        law_spread_m: sideways spread of the contact law that fits best [m]; the model itself has none.
        law_rise: log evidence of the widest spread considered over that of none; 0 unless it is the best.
        nonlinearity: nonlinear response that explains the presses better, if any does.
        effective_draws: effective sample size of the weighted draws.
        force_low: 2.5 % quantile of the scatter of forces.
        misfit_low: 2.5 % quantile of the misfit.
        rest_counts: rest level that all taxels share, on the scale of the data [counts].
        rest_interval: low and high of it.
        grid: the evaluated grid.
        presses: measured against simulated, press by press.
        problem: the presses that were used.
        box: the ranges that were searched.
        scale_per_taxel_per_n: (J,) scale of each taxel [1/N]; None unless asked for.
        dead_taxels: (J,) dead taxels, which were left out.
        findings: findings for the user.
    """

    best: Mapping[str, float]
    intervals: Mapping[str, tuple[float, float]]
    mse_counts2: float
    valley_mse_counts2: float
    bound: Literal["noise", "fixed"]
    draws: Floats
    sigmas: Sigmas
    law_spread_m: float
    law_rise: float
    nonlinearity: Nonlinearity
    effective_draws: float
    force_low: float
    misfit_low: float
    rest_counts: float
    rest_interval: tuple[float, float]
    grid: GridResult
    presses: PressFit
    problem: FitProblem
    box: SearchBox
    scale_per_taxel_per_n: Floats | None
    dead_taxels: Bools
    findings: tuple[FitFinding, ...]

    @property
    def gives_intervals(self) -> bool:
        """Return whether the data bound any parameter: there are enough readings, and the draws have converged."""
        return self.problem.determined and (self.bound == "fixed" or self.effective_draws >= FEWEST_DRAWS)


def extent_m(problem: FitProblem) -> float:
    """Return the larger of the two extents of the presses, across and along [m]."""
    return float(max(np.ptp(problem.across_m), np.ptp(problem.along_m)))


def at_one_place(problem: FitProblem) -> bool:
    """Return whether the presses lie too close together to separate turn and position of the sensor."""
    size = float(np.ptp(problem.rig.layout.centres_m, axis=0).max()) or problem.rig.slack_m
    return extent_m(problem) < ONE_PLACE * size
