"""The sensor's converter: rounding and clipping of taxel values to counts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from skincal.model.arrays import FloatArray


@dataclass(frozen=True)
class Converter:
    """The last stage of the skin: round, then clip (the paper's sensor: whole numbers from 0 to 255).

    Attributes:
        value_min: lowest value [counts]; ``None`` for no clipping below.
        value_max: highest value [counts]; ``None`` for no clipping above.
        integer: round to the nearest whole number (halves to the even one, as numpy does).
    """

    value_min: float | None = 0.0
    value_max: float | None = 255.0
    integer: bool = True

    def __post_init__(self) -> None:
        low = -np.inf if self.value_min is None else self.value_min
        high = np.inf if self.value_max is None else self.value_max
        if not low < high:
            raise ValueError(
                f"converter: expected value_min < value_max; got {self.value_min} and {self.value_max}"
            )

    @classmethod
    def none(cls) -> Converter:
        """Return a converter that changes nothing."""
        return cls(value_min=None, value_max=None, integer=False)

    def apply(self, values: ArrayLike) -> FloatArray:
        """Return counts for values of any shape [counts]; NaN stays NaN."""
        counts = np.array(values, dtype=np.float64)
        if self.integer:
            np.rint(counts, out=counts)
        if self.value_min is not None:
            np.maximum(counts, self.value_min, out=counts)
        return counts if self.value_max is None else np.minimum(counts, self.value_max, out=counts)
