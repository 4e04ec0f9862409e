"""Explain why presses cannot show an effect, and recommend presses or covariates that would."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from skincal.effects import COVARIATES, effect
from skincal.effects.samples import UNLOAD
from skincal.inference.session import GapSession
from skincal.model.arrays import FloatArray

_SPEED_RATIO, _FORCE_RATIO, _SHEAR_N = 1.2, 2.0, 0.05
"""Ratios of largest to smallest speed and force, and rms tangential force [N], below which they do not vary enough."""
_OVERLOAD = 1.05
"""Ratio of peak to hold force above which a hold was reached from above."""


@dataclass(frozen=True)
class EffectAudit:
    """Audit of one effect.

    Attributes:
        name: name of the effect.
        distance: detectability d' of a typical case: its distance from the base model in standard deviations, with the
            nuisance parameters of the presses and the base parameters eliminated.
        raw_distance: the same with nothing eliminated.
        threshold: required distance.
        smallest_strength: smallest visible strength; infinite if none is.
        lost_to_presses: fraction of the squared raw distance that the nuisance parameters of the presses absorb.
        lost_to_base: fraction that the base parameters absorb.
        lacking: covariates that were not recorded.
        overlaps: cosine with a typical case of each other effect.
        consistent_with: names that these data cannot distinguish from this one, itself first.
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
        """True if a typical case (strength 1) is visible."""
        return self.smallest_strength <= 1.0


@dataclass(frozen=True)
class PressVariety:
    """Variety of the presses of a session.

    Attributes:
        frames: whether loading and unloading were observed.
        falling: whether unloading was observed, or some hold was reached from above.
        clock: whether times were recorded.
        speeds: ratio of the fastest to the slowest loading; 1 if unknown.
        poses: number of hand poses.
        again: whether a site is touched again.
        forces: ratio of the largest to the smallest peak force.
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


def summarize_presses(session: GapSession) -> PressVariety:
    """Return the variety of the presses of a session."""
    samples = session.samples
    touching = samples.touching
    peaks = np.zeros(session.presses)
    np.maximum.at(peaks, session.row[touching], samples.contacts.force_n[touching])
    peaks = peaks[peaks > 0]
    speed, pose, cycle = samples.speed_m_per_s, samples.pose, samples.cycle
    observed = samples[session.observation >= 0]
    return PressVariety(
        session.has_frames,
        bool(np.isin(session.phase, [UNLOAD]).any()) or _is_reached_from_above(session),
        samples.time_s is not None,
        1.0 if speed is None else _ratio(speed[touching]),
        1 if pose is None else len(np.unique(pose[pose >= 0])),
        cycle is not None and bool((cycle[touching] > 0).any()),
        _ratio(peaks),
        len(np.unique(observed.indenter[observed.touching])),
        0.0 if samples.shear_n is None else float(np.sqrt(np.nanmean(samples.shear_n[touching] ** 2))),
    )


def _is_reached_from_above(session: GapSession) -> bool:
    """Return whether a hold of a session without frames was reached from a larger force."""
    if session.has_frames:
        return False
    force, row = session.samples.contacts.force_n, session.row
    peak, hold = np.zeros(session.presses), np.full(session.presses, np.inf)
    np.maximum.at(peak, row, force)
    observed = session.observation >= 0
    np.minimum.at(hold, row[observed], force[observed])
    return bool((peak > _OVERLOAD * hold).any())


def _ratio(values: FloatArray) -> float:
    known = values[np.isfinite(values) & (values > 0)]
    return float(known.max() / known.min()) if len(known) else 1.0


@dataclass(frozen=True)
class Rule:
    """A kind of press that an effect needs, and the words for a session without it.

    Attributes:
        missing: returns whether a session lacks such presses.
        text: description of the lack.
        cure: what to record.
        of: covariate that the rule depends on; the rule does not apply if the covariate was not recorded at all.
    """

    missing: Callable[[PressVariety], bool]
    text: str
    cure: str
    of: str = ""


TWO_POSES: Final = "press in two hand poses"
_THE_POSE: Final = "the hand's pose"
_ON_A_STAGE: Final = {
    TWO_POSES: "press with the sensor turned on its stage, too, as another pose",
    _THE_POSE: "the sensor's turn on its stage",
}
"""Recommendations for a hand, and the same for a rig without joints."""


_RULES: Final[Mapping[str, Rule]] = {
    "unloading": Rule(
        lambda f: not f.falling, "no frames, and no hold that is reached from above: unloading was not observed",
        COVARIATES["phase"].cure,
    ),
    "frames": Rule(
        lambda f: not f.frames, "no frames: only the mean of each hold was recorded", COVARIATES["phase"].cure
    ),
    "clock": Rule(lambda f: not f.clock, "no times of the presses were recorded", COVARIATES["time"].cure),
    "speeds": Rule(
        lambda f: f.speeds < _SPEED_RATIO,
        "all presses are equally fast, so that an effect of speed only changes the scale",
        "load slowly and fast", "speed",
    ),
    "again": Rule(lambda f: not f.again, "no site is touched a second time", "touch some sites again", "cycle"),
    "shear": Rule(
        lambda f: f.shear_n < _SHEAR_N, "there is hardly any tangential force",
        "press with tangential force, too", "shear",
    ),
    "poses": Rule(lambda f: f.poses < 2, "the hand was in one pose only", TWO_POSES, "pose"),
    "forces": Rule(
        lambda f: f.forces < _FORCE_RATIO, "all presses have about the same force", "press with small and large forces"
    ),
    "indenters": Rule(lambda f: f.radii < 2, "there is one indenter only", "press with a second indenter, too"),
}  # fmt: skip
"""Rule of each kind of press that an effect may need (:attr:`skincal.effects.Effect.asks`)."""


def explain_invisibility(audit: EffectAudit, variety: PressVariety) -> str:
    """Return why an effect is invisible: the covariates and kinds of press that are missing, else what hides it."""
    rules, lacking = _missing(audit, variety)
    texts = [rule.text for rule in rules]
    columns = [str(COVARIATES[name]) for name in lacking]
    if columns:
        texts.insert(0, f"no {' and no '.join(columns)} recorded")
    if texts:
        return "; ".join(texts)
    if audit.raw_distance < audit.threshold:
        return "in these presses its change is smaller than the noise"
    if audit.lost_to_base > audit.lost_to_presses:
        return "a change of pose, E and scale of the base model looks the same"
    return "the uncertainty of positions, forces and images of the presses hides it"


def recommend_recordings(audit: EffectAudit, variety: PressVariety) -> tuple[str, ...]:
    """Return what to record so that an effect becomes visible, a few words each."""
    rules, lacking = _missing(audit, variety)
    cures = dict.fromkeys([*(rule.cure for rule in rules), *(COVARIATES[name].cure for name in lacking)])
    if cures:
        return tuple(cures)
    if audit.raw_distance < audit.threshold:
        return ("press harder and on more taxels, and hold longer",)
    if audit.lost_to_base > audit.lost_to_presses:
        return (f"vary forces, sites and {_THE_POSE} more, independently of each other",)
    return ("measure positions and forces more accurately, or touch the same sites again",)


def phrase_for_stage(cure: str) -> str:
    """Return a recommendation in the words for a rig without joints."""
    for hand, stage in _ON_A_STAGE.items():
        cure = cure.replace(hand, stage)
    return cure


def _missing(audit: EffectAudit, variety: PressVariety) -> tuple[list[Rule], list[str]]:
    """Return the rules that a session breaks, and the further covariates that it lacks."""
    needed = (_RULES[kind] for kind in effect(audit.name).asks)
    rules = [r for r in needed if r.missing(variety) and r.of not in audit.lacking]
    return rules, [name for name in audit.lacking if not (rules and COVARIATES[name].clocked)]
