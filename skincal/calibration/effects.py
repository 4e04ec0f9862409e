"""The names that an effect beyond the base model may have."""

from __future__ import annotations

from typing import Final

EFFECT_NAMES: Final[dict[str, str]] = {
    "hysteresis": "at the same force the signal differs between loading and unloading",
    "creep": "the signal goes on rising (or falls) at constant force",
    "rate": "the response depends on the speed of loading",
    "latency": "the taxels lag behind the force in time",
    "first_cycle": "the first touch of a site answers otherwise than later ones",
    "baseline_drift": "the level at rest moves over the session",
    "gain_drift": "the sensitivity moves over the session (wear, temperature)",
    "spread": "a cover spreads the pressure sideways before it reaches the taxels",
    "crosstalk": "a taxel leaks into its nearest neighbours",
    "ghosting": "a taxel leaks along its row and column",
    "saturation": "large values are compressed or clipped",
    "dead_band": "small values are swallowed",
    "response_curve": "the counts are a nonlinear function of the taxel's load",
    "stiffening": "stress is a nonlinear function of penetration",
    "taxel_gain": "taxels differ in gain",
    "taxel_offset": "taxels differ in their level at rest",
    "dead_taxel": "one or more taxels do not answer or are stuck",
    "shear": "a tangential force moves or changes the image",
    "force_bias": "the measured force is off: offset, or a scale that depends on the hand's pose",
    "contact_offset": "the measured contact positions are off in a way that the pose cannot absorb",
    "indenter_radius": "the indenter is not the size the dataset says",
    "cover": "a glove carries part of the force before the skin feels it",
}
"""Name of each effect and what is meant by it."""
