"""Names of effects beyond the base model: those of the registry of effects."""

from __future__ import annotations

from typing import Final

from skincal.effects import EFFECTS

EFFECT_NAMES: Final[dict[str, str]] = {name: effect.meaning for name, effect in EFFECTS.items()}
"""Name and meaning of each effect, in the order of the chain."""
