"""What a diagnosis found, in words and small tables: the part of the report that a person reads first."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from skincal.effects import EFFECTS, EffectParameter
from skincal.gap.split import FINAL, SELECTION, TRAIN
from skincal.model.arrays import FloatArray
from skincal.report.diagnosis_candidates import critical_score, law_words, units
from skincal.report.diagnosis_words import left_words, unexplained
from skincal.report.fit_quantities import with_digits

if TYPE_CHECKING:
    from skincal.calibration import Effect
    from skincal.diagnose.diagnosis import Diagnosis, NamedEffect

Tone = Literal["good", "found", "attention"]


@dataclass(frozen=True)
class ParameterRow:
    """One line of the table of what was added, in words."""

    effect: str
    name: str
    meaning: str
    value: str
    interval: str
    final: str
    neutral: str


@dataclass(frozen=True)
class EffectRow:
    """One line of the table of all effects: what the data say of it, in words."""

    name: str
    meaning: str
    smallest: str
    tried: str
    outcome: str
    kind: str


def tone(found: Diagnosis) -> Tone:
    """How the verdict is coloured: nothing to do, something found, something open."""
    if found.verdict == "none":
        return "good"
    return "found" if found.verdict == "effects" and not found.unexplained else "attention"


def headline(found: Diagnosis) -> str:
    """The verdict in one sentence."""
    if found.verdict == "none":
        return "Nothing is missing that these presses could show."
    if found.verdict == "unknown":
        return unexplained(found)
    return f"Missing: {_and([names_of(e) for e in found.effects])}."


def names_of(effect: NamedEffect) -> str:
    """An effect, or all names that the data cannot tell apart."""
    return " or ".join(effect.consistent_with)


def _and(words: list[str]) -> str:
    return words[0] if len(words) == 1 else ", ".join(words[:-1]) + " and " + words[-1]


def verdict_sentences(found: Diagnosis) -> list[str]:
    """What the verdict says and what it rests on, a sentence or two each."""
    if found.verdict == "none":
        return [_no_score(found), _gap_sentence(found), *_not_shown(found), _calibration_sentence(found)]
    lines = [capital(found.where) + "."]
    if found.verdict == "unknown":
        lines += [*_depends(found), _tried(found), _gap_sentence(found)]
        return [*lines, *_not_shown(found), _calibration_sentence(found)]
    lines += [_effect_sentence(e, found) for e in found.effects]
    lines.append(_gap_sentence(found))
    if found.unexplained:
        near = "that no known effect explains"
        if found.choice.closest is not None:
            name, part = found.choice.closest
            near = f"(what comes closest, {name}, explains {percent(part)} of that)"
        left = f"{left_words(found)} of the excess residual is left"
        lines.append(f"{left} {near}: something else is missing, too.")
    return [*lines, *_not_shown(found), _calibration_sentence(found)]


def capital(text: str) -> str:
    """A sentence's beginning."""
    return text[:1].upper() + text[1:]


def percent(share: float) -> str:
    """A share as whole per cent."""
    return f"{100 * share:.0f} %".replace("-", "−")


def p_words(p: float, sessions: int) -> str:
    """A p-value, and the count that it is."""
    beaten = round(p * (1 + sessions)) - 1
    return f"p = {p:.2g}: {'none' if beaten <= 0 else beaten} of {sessions} null sessions did as well"


def _no_score(found: Diagnosis) -> str:
    null, rounds = found.null, found.choice.rounds
    count = len(null.laws)
    if not rounds:
        return "The base model leaves no more residual than sessions have in which nothing is hidden."
    best = rounds[0].found[0]
    p, asked = null.p_value(best.effect, best.scored), found.options.choice.significant
    if p > asked:
        return (
            f"The effect that does best, {best.effect}, scores no better than one does in sessions with nothing hidden "
            f"({p_words(p, count)}; {asked:g} is asked for)."
        )
    strongest = found.options.strongest(found.choice, found.signatures)
    depends = (
        f"nothing much more than in those sessions ({strongest:.1f} times the most; "
        f"{found.options.structure:g} is asked for)"
        if strongest
        else "nothing more than an unknown contact law may bring about"
    )
    values = max(found.choice.values, 1)
    weakest = (found.options.choice.least(values, found.choice.law) / values) ** 0.5
    return (
        f"The effect that does best, {best.effect}, scores better than in sessions with nothing hidden "
        f"({p_words(p, count)}), but no effect explains a fair part of what is left, or more than "
        f"{weakest:.2g} times the noise, and what is left depends on {depends}."
    )


def _effect_sentence(effect: NamedEffect, found: Diagnosis) -> str:
    share, chance = percent(min(effect.share, 1.0)), p_words(effect.p_value, len(found.null.laws))
    if effect.by_places:
        return (
            f"{capital(effect.name)} ({EFFECTS[effect.name].meaning}) explains {share} of the variance of where "
            f"presses turn out to be (p = {effect.p_value:.2g}, by presses that swap their places). "
            "Images do not show it."
        )
    text = (
        f"{capital(effect.name)} ({EFFECTS[effect.name].meaning}) explains {share} of the excess residual that was "
        f"left when it was added ({chance})."
    )
    others = effect.consistent_with[1:]
    if others:
        text += f" These presses cannot tell it from {_and(list(others))}; {effect.name} is what was added."
    return text


def _gap_sentence(found: Diagnosis) -> str:
    gap = found.gap
    where = f"on {gap.presses} presses that neither the fit nor the choice has seen"
    if found.verdict != "effects":
        return (
            f"{capital(where)}, simulated and measured values differ by {gap.before:.3g} counts rms a taxel; noise "
            f"alone makes {gap.floor:.3g}."
        )
    if found.only_places:
        return (
            f"{capital(where)}, the places that fit best lie {1e3 * gap.slack_before_m:.2f} mm rms from the measured "
            f"ones before, and {1e3 * gap.slack_after_m:.2f} mm from those that the new model says. At these places "
            f"simulated and measured values differ by {gap.before:.3g} counts rms a taxel before and {gap.after:.3g} "
            f"after; noise alone makes {gap.floor:.3g}."
        )
    if not np.isfinite(gap.closed):
        return (
            f"{capital(where)}, simulated and measured values differ by {gap.before:.3g} counts rms a taxel before and "
            f"{gap.after:.3g} after; noise alone makes {gap.floor:.3g}: no gap there that what was named could close."
        )
    low, high = gap.interval
    return (
        f"{capital(where)}, the error falls from {gap.before:.3g} to {gap.after:.3g} counts rms a taxel; noise alone "
        f"makes {gap.floor:.3g}. {percent(gap.closed)} of the gap is closed ({percent(low)} to {percent(high)})."
    )


def _not_shown(found: Diagnosis) -> list[str]:
    names = list(found.audit.cannot_see)
    return [f"These presses could not show {_and(names)}; why not, is said below."] if names else []


def _calibration_sentence(found: Diagnosis) -> str:
    if found.verdict == "effects":
        return "The new calibration has what was named, fitted once more to all presses. The old one stays as it is."
    return "The calibration written is the given one, unchanged."


def _depends(found: Diagnosis) -> list[str]:
    left, times = found.choice.left, found.null.times_most(found.choice.excess[1])
    lines: list[str] = []
    if found.options.misfits(left, times):
        lines.append(
            f"What is left is {left:.2g} times the noise; its square lies {times:.0f} times as far above that of the "
            "mean null session as in any of them."
        )
    if found.depends_on:
        lines.append(f"It goes along with {found.depends_on}; these shares overlap.")
    return lines


def _tried(found: Diagnosis) -> str:
    choice, names = found.choice, [n.name for n in found.choice.named]
    if found.refuted:
        gap = found.gap
        return (
            f"{_and(names)} would explain {percent(choice.explained)} of the excess, but presses that nobody has "
            f"fitted are further off then, {gap.after:.3g} counts instead of {gap.before:.3g}: it is not added."
        )
    if found.wide_open:
        gap = found.gap
        return (
            f"{_and(names)} explains {percent(choice.explained)} of the excess, but presses that nobody has fitted "
            f"stay off with it, {gap.after:.3g} counts instead of {gap.before:.3g}: it is not what is missing."
        )
    if names:
        return (
            f"With {_and(names)} in the model {percent(choice.explained)} of the excess is explained; "
            f"{percent(found.options.choice.explained)} is asked for before effects are named."
        )
    falls = choice.rounds[0].falls if choice.rounds else {}
    best = max(falls.items(), key=lambda item: item[1], default=("", 0.0))
    if not best[0] or choice.excess[0] <= 0:
        return "No known effect explains a fair part of it."
    return f"What comes closest, {best[0]}, explains {percent(best[1] / choice.excess[0])} of it."


def parameter_rows(found: Diagnosis) -> list[ParameterRow]:
    """What was added: parameters as fitted without the held-out presses, and as they are in the new calibration."""
    final = {e.name: e for e in found.calibration.effects}
    rows: list[ParameterRow] = []
    for effect in found.effects:
        for p in EFFECTS[effect.name].parameters:
            if p.name in effect.parameters:
                rows.append(_parameter_row(effect, p, final.get(effect.name)))  # noqa: PERF401
    return rows


def _parameter_row(effect: NamedEffect, p: EffectParameter, final: Effect | None) -> ParameterRow:
    value = np.atleast_1d(effect.parameters[p.name])
    low, high = (np.atleast_1d(end) for end in effect.intervals[p.name])
    unit = "" if p.unit in ("-", "") else f" {p.unit}"
    last = None if final is None else final.parameters.get(p.name)
    own = None if last is None else np.atleast_1d(np.asarray(last, dtype=np.float64))
    fitted = bool((high > low).any())
    return ParameterRow(
        effect.name,
        p.name,
        p.description,
        _values(value, high - low) + unit,
        (_interval(value, low, high) if fitted else "held")
        + (", at its bound" if p.name in effect.at_bound else ""),
        "" if own is None else _values(own, high - low),
        f"{p.neutral:g}" if p.role == "strength" else "form",
    )


def _values(values: FloatArray, width: FloatArray) -> str:
    wide = float(np.median(width[width > 0])) if (width > 0).any() else float("nan")
    if len(values) == 1:
        return with_digits(float(values[0]), wide)
    moved = np.unique(values)
    if len(moved) == 1:
        return f"{with_digits(float(moved[0]), wide)} each"
    return f"{len(values)} values, {with_digits(float(values.min()), wide)} to {with_digits(float(values.max()), wide)}"


def _interval(value: FloatArray, low: FloatArray, high: FloatArray) -> str:
    if len(value) == 1:
        width = float(high[0] - low[0])
        return f"{with_digits(float(low[0]), width)} to {with_digits(float(high[0]), width)}"
    half = (high - low) / 2
    return f"± {float(np.median(half[half > 0])):.2g} (median)"


def effect_rows(found: Diagnosis) -> list[EffectRow]:
    """All effects of the catalogue, in the order of the chain, and what the data say of each."""
    first = found.choice.rounds[0] if found.choice.rounds else None
    scored = (
        {}
        if first is None
        else dict(zip((f.effect for f in first.found), units(found.null, first), strict=True))
    )
    return [_effect_row(found, name, scored.get(name)) for name in EFFECTS]


def _effect_row(found: Diagnosis, name: str, score: float | None) -> EffectRow:
    audit = found.audit.effects[name]
    smallest = audit.smallest_strength
    seen = "never" if not np.isfinite(smallest) else "< 0.01" if smallest < 0.01 else f"{smallest:.2g}"
    tried = "" if score is None else "0" if score <= 0 else f"{score:.0f}" if score >= 10 else f"{score:.1f}"
    outcome, kind = _outcome(found, name, score)
    return EffectRow(name, EFFECTS[name].meaning, seen, tried, outcome, kind)


def _outcome(found: Diagnosis, name: str, score: float | None) -> tuple[str, str]:
    for effect in found.effects:
        if name == effect.name:
            return "named and added", "named"
        if name in effect.consistent_with:
            return f"cannot be told from {effect.name}", "rival"
    if name in found.taken_back:
        return "explains much, but not on presses nobody has fitted", "no"
    if name in found.audit.cannot_see:
        return f"cannot be seen: {found.audit.reasons.get(name, '')}", "blind"
    if name in {e.name for e in found.calibration.effects}:
        return "in the calibration already", "there"
    if score is None:
        return "no sign of it, to first order", "no"
    if score < critical_score(found):
        return "no sign of it", "no"
    return (
        "others explain more, or are simpler" if found.effects else "significant, but explains too little",
        "no",
    )


def noise_rows(found: Diagnosis) -> list[tuple[str, str, str]]:
    """What, how much with its interval, and from what it was found."""
    floor = found.floor
    rows = [("mean of a hold", _counts(floor.mean_counts, floor.mean_interval), floor.mean_from)]
    if floor.frame_counts != floor.mean_counts:
        frame = _counts(floor.frame_counts, floor.frame_interval)
        rows.insert(0, ("one frame, before rounding", frame, floor.frame_from))
    if floor.taxel_counts:
        noisy = [
            own for own in floor.taxel_counts if own > floor.frame_counts
        ]  # by_taxel says there are some
        words = f"{len(noisy)} of {len(floor.taxel_counts)} taxels, each by its own hold frames"
        rows.append(("one frame of a noisier taxel", f"{min(noisy):.1f} to {max(noisy):.1f} counts", words))
    if floor.rounding_counts > 0 and floor.frame_counts != floor.mean_counts:
        rows.append(("added to a frame by rounding", f"{floor.rounding_counts:.3f} counts", "whole numbers"))
    if not np.isfinite(floor.repeat_counts):
        rows.append(
            (
                "hold means of repeats differ by",
                "not known",
                "no press was repeated, or too few taxels saw it",
            )
        )
    else:
        words = "exact repeats; a bound from above, as no press comes back to quite the same place"
        rows.append(
            ("hold means of repeats differ by", _counts(floor.repeat_counts, floor.repeat_interval), words)
        )
    last = f"{found.gap.floor:.3f} counts"
    rows.append(("held-out presses, as they were compared", last, "the above, at their values"))
    return rows


def _counts(value: float, interval: tuple[float, float]) -> str:
    return f"{value:.3f} counts ({interval[0]:.3f} to {interval[1]:.3f})"


def method_sentences(found: Diagnosis) -> list[str]:
    """How it was done: split, null sessions, seed."""
    part = found.split.part
    used = np.unique(found.session.press[found.session.press >= 0])
    learned, chose, kept = (int((part[used] == p).sum()) for p in (TRAIN, SELECTION, FINAL))
    laws = Counter(found.null.laws)
    drawn = ", ".join(f"{count} under {law_words(law)}" for law, count in laws.items())
    m = found.material
    return [
        f"{len(used)} presses: {learned} to find parameters on, {chose} to choose among effects, {kept} kept for the "
        "end, in blocks of session time; some sites are kept as a whole.",
        f"{len(m.session)} observations of {m.reading.counts.shape[1]} taxels were looked at"
        + (", means over a few frames each." if found.session.has_frames else ", the means of the holds."),
        f"{len(found.null.laws)} null sessions of these presses, with nothing hidden: {drawn}. A score counts when "
        f"at most {100 * found.options.choice.significant:g} % of them reach it with any effect.",
        f"Places of presses were free within {1e3 * m.options.position_sigma_m:.2g} mm, forces within "
        f"{100 * m.options.force_sigma:.2g} % (one standard deviation), alike before and after.",
        f"Seed {found.seed}.",
    ]
