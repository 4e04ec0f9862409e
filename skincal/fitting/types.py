"""Array types of the fit."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.floating[Any]]
"""Floating-point numbers; single precision in large tables, else double."""

Ints = NDArray[np.intp]
"""Indices."""
Bools = NDArray[np.bool_]
"""Masks."""
