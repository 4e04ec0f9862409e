"""Where simulation and data disagree: what a session can show at all, and what noise hides. Arrays in, arrays out."""

from skincal.gap.audit import AuditOptions, EffectAudit, Linearised, Lost, audit, linearise
from skincal.gap.base import BASE, BaseColumns, BaseModel, base_columns
from skincal.gap.noise import NoiseFloor, Whitening, assumed_floor, noise_floor
from skincal.gap.projection import Projection
from skincal.gap.reasons import Facts, facts_of, why_not
from skincal.gap.sensitivity import EffectColumns, Simulator, all_columns, effect_columns
from skincal.inference.session import Binning, GapSession, binned, of_holds
from skincal.gap.split import FINAL, SELECTION, TRAIN, Split, SplitOptions, split_presses

__all__ = [
    "BASE",
    "FINAL",
    "SELECTION",
    "TRAIN",
    "AuditOptions",
    "BaseColumns",
    "BaseModel",
    "Binning",
    "EffectAudit",
    "EffectColumns",
    "Facts",
    "GapSession",
    "Linearised",
    "Lost",
    "NoiseFloor",
    "Projection",
    "Simulator",
    "Split",
    "SplitOptions",
    "Whitening",
    "all_columns",
    "assumed_floor",
    "audit",
    "base_columns",
    "binned",
    "effect_columns",
    "facts_of",
    "linearise",
    "noise_floor",
    "of_holds",
    "split_presses",
    "why_not",
]
