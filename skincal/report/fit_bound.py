"""Sentences about the bound of a fit's valley, for its report."""

from __future__ import annotations

from skincal.calibration import Calibration
from skincal.fitting.result import FitResult


def bound_story(result: FitResult, calibration: Calibration) -> list[str]:
    """Return sentences about the origin of the valley's bound, and of the intervals."""
    if result.bound == "fixed":
        return [_of_a_given_bound(result)]
    what = (
        "The valley is the set of parameters that the data cannot distinguish, given their noise. The fit starts from "
        "the best points of the grid. It integrates over the error of every contact position and force, and estimates "
        "the size of these errors and of the image noise along with the parameters."
    )
    if not result.told:
        return [f"{what} These data are too few for it, so no interval is given."]
    level = calibration.provenance.options.get("level")
    part = f"the central {100 * float(level):g} %" if isinstance(level, int | float) else "the central part"
    story = [
        f"{what} Intervals hold {part} of the draws from this distribution. With every press at its best position "
        f"within its slack, 98 % of the draws leave a loss below {_bound(result)}.",
        _of_the_grid(result),
    ]
    if result.law_spread_m > 0:
        story.append(
            "A skin may spread pressure sideways, which the model does not. The intervals include how much this could "
            f"change the parameters; a spread of {1e3 * result.law_spread_m:.2f} mm fits best."
        )
    return story


def _bound(result: FitResult) -> str:
    return f"{result.valley_mse_counts2:.3g} counts² (rmse {result.valley_mse_counts2**0.5:.2g} counts)"


def _of_a_given_bound(result: FitResult) -> str:
    inside, combinations = int(result.grid.in_valley.sum()), result.grid.grid.combinations
    extent = "The intervals are their extent." if result.told else "These data are too few for an interval."
    return (
        f"The bound was given: the valley is every combination of the grid with a loss below {_bound(result)}; these "
        f"are {inside:,} of {combinations:,}. {extent} Such a bound ignores the noise of these data; without "
        "it, the bound follows from the noise."
    )


def _of_the_grid(result: FitResult) -> str:
    grid = result.grid
    as_good = int((grid.mse_counts2 <= grid.mse_at_best_counts2).sum())
    others = f"{as_good:,}" if as_good else "none"
    return (
        f"The effective number of draws is {result.effective_draws:.0f}. The grid of {grid.grid.combinations:,} "
        "points only gave their start. As in the paper, the grid places every press by its normalised image, with a "
        f"loss of {grid.mse_at_best_counts2:.3g} counts² at the best point. The absolute images, which determine a "
        f"position better, have a loss of {result.mse_counts2:.3g} counts² there; the two losses are not comparable. "
        f"In the loss of the grid, {others} of its points can match the best point."
    )
