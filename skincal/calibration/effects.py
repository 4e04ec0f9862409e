"""The names that an effect beyond the base model may have: those of the registry of effects."""

from __future__ import annotations

from typing import Final

from skincal.effects import EFFECTS

EFFECT_NAMES: Final[dict[str, str]] = {name: effect.meaning for name, effect in EFFECTS.items()}
"""Name of each effect and what is meant by it, in the order of the chain."""
