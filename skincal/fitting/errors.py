"""Errors of a fit."""

from __future__ import annotations

NOWHERE = (
    "no pose, elasticity and scale near the best one explain the presses: their positions, forces and images do not "
    "belong together"
)


class FitError(ValueError):
    """The presses do not allow a fit."""
