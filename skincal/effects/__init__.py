"""Effects of a skin beyond the base model: one file per effect, one registry, whole sessions or sample by sample."""

from skincal.covariates import COVARIATES
from skincal.effects.effect import (
    Effect,
    InputEffect,
    LawEffect,
    MemoryEffect,
    SignalEffect,
    SpreadEffect,
    Stage,
)
from skincal.effects.effect_skin import Contacted, EffectSkin, SkinStream
from skincal.effects.holds import HoldSession, Steps, hold_session, hold_times, met_before
from skincal.effects.parameter import EffectParameter, Values, start
from skincal.effects.registry import EFFECTS, Applied, effect
from skincal.effects.samples import Samples, Setting

__all__ = [
    "COVARIATES", "EFFECTS", "Applied", "Contacted", "Effect", "EffectParameter", "EffectSkin", "HoldSession",
    "InputEffect", "LawEffect", "MemoryEffect", "Samples", "Setting", "SignalEffect", "SkinStream",
    "SpreadEffect", "Stage", "Steps", "Values", "effect", "hold_session", "hold_times", "met_before", "start",
]  # fmt: skip
