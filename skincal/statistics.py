"""Statistics of values with outliers."""

import numpy as np
from numpy.typing import NDArray

TO_SIGMA = 1.4826
"""Standard deviation over the median absolute deviation of a normal distribution."""


def robust_sigma(values: NDArray[np.floating], about: float | None = None) -> float:
    """Return the standard deviation by the median absolute deviation from ``about``; None: from the median."""
    about = float(np.median(values)) if about is None else about
    return TO_SIGMA * float(np.median(np.abs(values - about)))
