"""Interface of simulated images to the likelihood, whichever way they are made."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from skincal.fitting.lookup import Tables
from skincal.fitting.types import Floats


class Images(Protocol):
    """Simulated images round some macro variables."""

    def tables(self) -> Tables:
        """Return the tables that are looked up in."""
        ...


def to_patch(across_m: Floats, along_m: Floats, alpha_rad: Floats) -> Floats:
    """Patch coordinates (n, 2) of offsets from the centre across and along (contract: the inverse of the turn)."""
    cos, sin = np.cos(alpha_rad), np.sin(alpha_rad)
    return np.stack([across_m * cos + along_m * sin, along_m * cos - across_m * sin], axis=-1)


def from_patch(uv_m: Floats, alpha_rad: Floats) -> Floats:
    """Offsets (n, 2) across and along of patch coordinates."""
    cos, sin = np.cos(alpha_rad), np.sin(alpha_rad)
    u, v = uv_m[..., 0], uv_m[..., 1]
    return np.stack([u * cos - v * sin, u * sin + v * cos], axis=-1)
