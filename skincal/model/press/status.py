"""Outcomes of a press."""

from __future__ import annotations

from enum import IntEnum


class Status(IntEnum):
    """Outcome of a press."""

    OK = 0
    """The patch carries the force, and the press stays inside it."""
    NO_FORCE = 1
    """The force is zero or negative: no load."""
    NOT_TOUCHED = 2
    """No point of the patch is touched: no load, although there is a force."""
    AT_BORDER = 3
    """The press reaches the patch's border: the points in contact carry the whole force."""
    UNKNOWN = 4
    """The force, position or normal is NaN or infinite: the load is NaN."""
    FINER_THAN_POINTS = 5
    """The indenter lies over the patch but falls between its points: the load is meaningless."""
    THROUGH_FINGER = 6
    """The penetration exceeds the depth of the indenter or the finger: the model no longer holds."""
