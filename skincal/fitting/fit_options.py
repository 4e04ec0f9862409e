"""Options of a fit."""

from __future__ import annotations

import math
from dataclasses import dataclass

PAPER_BOUND_COUNTS2 = 25.0
"""The paper's bound of the valley: a root mean square error of five counts per taxel."""


@dataclass(frozen=True)
class SearchBox:
    """The ranges to search, each low and high.

    Attributes:
        across_m: position of the sensor's centre around the surface: arc length R beta, or x on a plane [m].
        y_m: position along the axis [m].
        alpha_rad: turn [rad].
        elasticity_pa_per_m: E [Pa/m].
    """

    across_m: tuple[float, float]
    y_m: tuple[float, float]
    alpha_rad: tuple[float, float]
    elasticity_pa_per_m: tuple[float, float] = (1e8, 2e9)


@dataclass(frozen=True)
class GridSteps:
    """Steps of the macro grid in the search box; the defaults are as fine as the paper's result or finer.

    Attributes:
        across_m: step around the surface, arc length [m].
        y_m: step along the axis [m].
        alpha_rad: step of the turn [rad].
        elasticities: number of values of E, spaced evenly in its log.
    """

    across_m: float = 1.0e-3
    y_m: float = 0.5e-3
    alpha_rad: float = math.radians(2.5)
    elasticities: int = 16


GENERAL_STEPS = GridSteps(2.5e-3, 2.5e-3, math.radians(13.5), 4)
"""Grid steps if every combination runs nlopt on the skin model: some hundreds of combinations. The continuous
refinement converges from this far: in sessions like the paper's it ended at the same peak as from a fine
grid."""

LOCAL_STEPS = GridSteps(1.25e-3, 1.0e-3, math.radians(5.0), 12)
"""Grid steps on the uniform local surface, which only provides starts for the skin model."""

STEPS = {"fast": GridSteps(), "general": LOCAL_STEPS, "nlopt": GENERAL_STEPS}
"""Default grid steps by the method of the fit."""


@dataclass(frozen=True)
class FitOptions:
    """Settings of a fit.

    Attributes:
        steps: of the macro grid; None for the default of the method.
        active_counts: value above rest from which a taxel is active; None to derive it from the data.
        min_active: least number of active taxels of a press that is used; None for two, or one if few presses
            have two.
        bound_counts2: None for the valley that the noise of the data defines; a number for all combinations
            of the grid whose loss is below it (the paper's is 25).
        level: probability content of the intervals, if the noise defines them.
        draws: number of draws from the valley that are kept.
        rounds: fewest and most rounds of the sampling.
        round_size: draws in each round.
        enough_draws: effective sample size at which sampling stops.
        per_taxel: whether to estimate a scale for every taxel.
        law_spreads_m: widths of sideways spread that represent the uncertainty of the contact law [m].
    """

    steps: GridSteps | None = None
    active_counts: float | None = None
    min_active: int | None = None
    bound_counts2: float | None = None
    level: float = 0.98
    draws: int = 2000
    rounds: tuple[int, int] = (10, 80)
    round_size: int = 100
    enough_draws: int = 400
    per_taxel: bool = False
    law_spreads_m: tuple[float, ...] = (0.0, 0.1e-3, 0.2e-3, 0.3e-3, 0.4e-3)
