"""In words: why presses cannot show an effect, and what kind of press or covariate would."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

import numpy as np

from skincal.effects import COVARIATES, effect
from skincal.effects.samples import UNLOAD
from skincal.inference.session import GapSession
from skincal.model.arrays import FloatArray

_SAME_SPEED = 1.2
_SHEAR_N = 0.05
_FORCE_RATIO = 2.0


@dataclass(frozen=True)
class EffectAudit:
    """What presses tell of one effect.

    Attributes:
        name: of the effect.
        distance: standard deviations that a typical case lies off, all nuisances and the base model taken out.
        raw_distance: the same before anything is taken out.
        threshold: distance that is needed.
        smallest_strength: at which it is found; infinite where no strength is.
        lost_to_presses: part of the square that the presses' own numbers take up.
        lost_to_base: the same of the base model.
        lacking: covariates that were not recorded.
        overlaps: cosine with a typical case of each other effect.
        consistent_with: names that these data cannot tell apart from this one, itself first.
    """

    name: str
    distance: float
    raw_distance: float
    threshold: float
    smallest_strength: float
    lost_to_presses: float
    lost_to_base: float
    lacking: tuple[str, ...]
    overlaps: Mapping[str, float]
    consistent_with: tuple[str, ...]

    @property
    def visible(self) -> bool:
        """Whether a typical case is found."""
        return self.smallest_strength <= 1.0


@dataclass(frozen=True)
class Facts:
    """What kind of presses a session has.

    Attributes:
        frames: loading and unloading were observed.
        falling: some hold is reached from above, or unloading was observed.
        clock: times were recorded.
        speeds: the fastest loading over the slowest; 1 where not known.
        poses: number of hand poses.
        again: a site is touched again.
        forces: the largest hold force over the smallest.
        radii: number of different indenters.
        shear_n: root mean square tangential force [N].
    """

    frames: bool
    falling: bool
    clock: bool
    speeds: float
    poses: int
    again: bool
    forces: float
    radii: int
    shear_n: float


def facts_of(session: GapSession) -> Facts:
    """Looks at the presses of a session."""
    samples = session.samples
    touched = samples.touching
    peaks = np.zeros(session.presses)
    np.maximum.at(peaks, session.row[touched], samples.contacts.force_n[touched])
    peaks = peaks[peaks > 0]
    speed, pose, cycle = samples.speed_m_per_s, samples.pose, samples.cycle
    seen = samples[session.observation >= 0]
    return Facts(
        session.has_frames,
        bool(np.isin(session.phase, [UNLOAD]).any()) or _from_above(session),
        samples.time_s is not None,
        1.0 if speed is None else _ratio(speed[touched]),
        1 if pose is None else len(np.unique(pose[pose >= 0])),
        cycle is not None and bool((cycle[touched] > 0).any()),
        _ratio(peaks),
        len(np.unique(seen.indenter[seen.touching])),
        0.0 if samples.shear_n is None else float(np.sqrt(np.nanmean(samples.shear_n[touched] ** 2))),
    )


def _from_above(session: GapSession) -> bool:
    """Whether a press without frames was loaded beyond its hold."""
    if session.has_frames:
        return False
    force, row = session.samples.contacts.force_n, session.row
    most, held = np.zeros(session.presses), np.full(session.presses, np.inf)
    np.maximum.at(most, row, force)
    seen = session.observation >= 0
    np.minimum.at(held, row[seen], force[seen])
    return bool((most > 1.05 * held).any())


def _ratio(values: FloatArray) -> float:
    known = values[np.isfinite(values) & (values > 0)]
    return float(known.max() / known.min()) if len(known) else 1.0


@dataclass(frozen=True)
class Rule:
    """What a session lacks, in words.

    Attributes:
        missing: whether it does.
        text: what to say.
        cure: what to record instead.
        of: covariate that the rule looks at; where it was not recorded at all, that is said instead.
    """

    missing: Callable[[Facts], bool]
    text: str
    cure: str
    of: str = ""


TWO_POSES: Final = "press in two hand poses"
_THE_POSE: Final = "the hand's pose"
_ON_A_STAGE: Final = {
    TWO_POSES: "press with the sensor turned on its stage, too, as another pose",
    _THE_POSE: "the sensor's turn on its stage",
}
"""Cures of a hand, and what they are on a rig without joints."""


_NO_FRAMES = Rule(
    lambda f: not f.frames, "no frames: only the mean of each hold was recorded", "record every frame"
)
_NO_CLOCK = Rule(
    lambda f: not f.clock, "no times of the presses were recorded", "record when each press begins and ends"
)
_ONE_POSE = Rule(lambda f: f.poses < 2, "the hand was in one pose only", TWO_POSES, "pose")
_ONE_FORCE = Rule(
    lambda f: f.forces < _FORCE_RATIO, "all presses are about equally hard", "press gently and hard"
)
_NO_UNLOADING = Rule(
    lambda f: not f.falling,
    "no frames, and no hold that is reached from above: unloading is not seen",
    "record every frame",
)
_ONE_SPEED = Rule(
    lambda f: f.speeds < _SAME_SPEED,
    "all presses are equally fast, which only moves the scale",
    "load slowly and fast",
    "speed",
)
_ONE_TOUCH = Rule(lambda f: not f.again, "no site is touched a second time", "come back to sites", "cycle")
_NO_SHEAR = Rule(
    lambda f: f.shear_n < _SHEAR_N,
    "there is hardly any tangential force",
    "press with tangential force, too",
    "shear",
)
_ONE_INDENTER = Rule(lambda f: f.radii < 2, "there is one indenter only", "press with a second indenter, too")

_RULES: Final[Mapping[str, Rule]] = MappingProxyType(
    {
        "unloading": _NO_UNLOADING,
        "frames": _NO_FRAMES,
        "clock": _NO_CLOCK,
        "speeds": _ONE_SPEED,
        "again": _ONE_TOUCH,
        "shear": _NO_SHEAR,
        "poses": _ONE_POSE,
        "forces": _ONE_FORCE,
        "indenters": _ONE_INDENTER,
    }
)
"""Kinds of presses that effects ask for (:attr:`skincal.effects.Effect.asks`)."""


def why_not(found: EffectAudit, facts: Facts) -> str:
    """Why an effect cannot be seen: the covariates and kinds of press that are missing, else what hides it."""
    rules, lacking = _missing(found, facts)
    said = [rule.text for rule in rules]
    columns = [str(COVARIATES[name]) for name in lacking]
    if columns:
        said.insert(0, f"no {' and no '.join(columns)} recorded")
    if said:
        return "; ".join(said)
    if found.raw_distance < found.threshold:
        return "in these presses it does less than the noise"
    if found.lost_to_base > found.lost_to_presses:
        return "another pose, E and scale of the base model look the same"
    return "places, forces and the doubt of each press's image take it up"


def cures(found: EffectAudit, facts: Facts) -> tuple[str, ...]:
    """What to record so that an effect can be seen, a few words each."""
    rules, lacking = _missing(found, facts)
    said = dict.fromkeys([*(rule.cure for rule in rules), *(COVARIATES[name].cure for name in lacking)])
    if said:
        return tuple(said)
    if found.raw_distance < found.threshold:
        return ("press harder and on more taxels, and hold longer",)
    if found.lost_to_base > found.lost_to_presses:
        return (f"vary forces, sites and {_THE_POSE} more, each apart from the others",)
    return ("measure places and forces better, or come back to the same sites",)


def on_a_stage(cure: str) -> str:
    """Return a cure for a rig without joints."""
    for hand, stage in _ON_A_STAGE.items():
        cure = cure.replace(hand, stage)
    return cure


def _missing(found: EffectAudit, facts: Facts) -> tuple[list[Rule], list[str]]:
    """The rules that a session breaks, and the covariates beside them that it lacks."""
    asked = (_RULES[kind] for kind in effect(found.name).asks)
    rules = [r for r in asked if r.missing(facts) and r.of not in found.lacking]
    # Without a clock that is said already, and a temperature only adds to what a clock shows.
    told = {"time", "phase", "temperature"} if rules else set[str]()
    return rules, [name for name in found.lacking if name not in told]
