"""What a fit may fail of."""

from __future__ import annotations


class FitError(ValueError):
    """The presses do not allow a fit."""
