"""Properties of finding codes: their cause, whether a diagnosis supersedes them, and advice for other rigs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True)
class Code:
    """Properties of a code of a fit's findings.

    Attributes:
        of_images: whether images in the wrong order, or of corrupted values, can cause it.
        of_base_model: whether it says how well images match the base model, or where its intervals end. A
            diagnosis, which extends the model, supersedes it.
        on_a_stage: advice for a rig without joints; '' for the advice of the finding.
    """

    of_images: bool = False
    of_base_model: bool = False
    on_a_stage: str = ""


_IMAGES, _MATCH = Code(of_images=True), Code(of_images=True, of_base_model=True)

CODES: Final = {
    **dict.fromkeys(("dead_taxel", "few_draws", "lost_readings", "not_identified", "rest_in_doubt"), _IMAGES),
    **dict.fromkeys(("misfit", "range_edge", "bad_presses", "glitches"), _MATCH),
    **dict.fromkeys(("response_bends", "contact_law", "slack_too_tight"), _MATCH),
    "force_scatter": Code(
        True, True, "Check the zero of the load cell, and that it measures along the normal of the skin."
    ),
    "positions_worse": Code(
        True,
        True,
        "Check how the stage's axes lie to the sensor, and the offset of the indenter's tip; raise [position] sigma_m "
        "and slack_m.",
    ),
    "positions_bent": Code(
        True, True, "Align the axes of the stage with the sensor's edges for a sharper alpha."
    ),
}
"""Codes with properties; all others have those of ``Code()``."""


def code_of(name: str) -> Code:
    """Return the properties of a code."""
    return CODES.get(name, Code())
