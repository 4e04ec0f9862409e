"""What bounds the valley of a fit, in sentences for its report."""

from __future__ import annotations

from skincal.calibration import Calibration
from skincal.fitting.result import FitResult


def bound_story(result: FitResult, calibration: Calibration) -> list[str]:
    """How the bound of the valley, and with it the intervals, came about."""
    if result.bound == "fixed":
        return [_of_a_given_bound(result)]
    what = (
        "The valley is what the data cannot tell apart, given their own noise. From the best points of the grid on, "
        "the fit goes on continuously: the error of every contact position and force is integrated over, and how "
        "large these errors and the noise of the images are is estimated along with the parameters."
    )
    if not result.told:
        return [f"{what} These data tell too little for it, so no interval is given."]
    level = calibration.provenance.options.get("level")
    part = f"the central {100 * float(level):g} %" if isinstance(level, int | float) else "the central part"
    story = [
        f"{what} Intervals hold {part} of the draws from this distribution. With every press at its best place within "
        f"its slack, 98 % of the draws leave less than {_bound(result)}.",
        _of_the_grid(result),
    ]
    if result.law_spread_m > 0:
        story.append(
            "A skin may spread pressure sideways, which the model does not. The intervals include what this could "
            f"change; a spread of {1e3 * result.law_spread_m:.2f} mm fits best."
        )
    return story


def _bound(result: FitResult) -> str:
    return f"{result.valley_mse_counts2:.3g} counts² (rmse {result.valley_mse_counts2**0.5:.2g} counts)"


def _of_a_given_bound(result: FitResult) -> str:
    inside, combinations = int(result.grid.in_valley.sum()), result.grid.grid.combinations
    extent = (
        "The intervals are their extent." if result.told else "These data tell too little for an interval."
    )
    return (
        f"The bound was given: the valley is every combination of the grid whose loss is below {_bound(result)}; these "
        f"are {inside:,} of {combinations:,}. {extent} Such a bound knows nothing of the noise of these data; without "
        "it the bound follows from the noise."
    )


def _of_the_grid(result: FitResult) -> str:
    grid = result.grid
    as_good = int((grid.mse_counts2 <= grid.mse_at_best_counts2).sum())
    return (
        f"The draws are worth {result.effective_draws:.0f} independent ones. The grid of {grid.grid.combinations:,} "
        "combinations only gave them a start. As in the paper it places every press by its normalised image, which "
        f"leaves {grid.mse_at_best_counts2:.3g} counts² at the best point; the absolute images, which tell more of a "
        f"place, leave {result.mse_counts2:.3g} counts² there. The two are not to be compared. By the loss of the grid "
        f"{as_good:,} of its combinations are as good as the best point."
    )
