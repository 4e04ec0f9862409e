"""A diagnosis in words, for the terminal and the page."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Literal

import numpy as np

from skincal.effects import EFFECTS

if TYPE_CHECKING:
    from skincal.diagnosis.diagnosis import Diagnosis, NamedEffect

Tone = Literal["good", "found", "attention"]


def tone(found: Diagnosis) -> Tone:
    """How the verdict is coloured: nothing to do, something found, something open."""
    if found.verdict == "none":
        return "good"
    return "found" if found.verdict == "effects" and not found.unexplained else "attention"


def headline(found: Diagnosis) -> str:
    """Return the verdict in one sentence."""
    if found.verdict == "none":
        return "Nothing is missing that these presses could show."
    if found.verdict == "effects":
        return "Missing: " + " and ".join(" or ".join(e.consistent_with) for e in found.effects) + "."
    if found.taken_back and found.gap.refutes:
        return (
            f"Something is missing. {_and(found.taken_back)} would explain it, but puts presses "
            f"that nobody has fitted further off."
        )
    if found.taken_back:
        return (
            f"Something is missing. {_and(found.taken_back)} explains a part of it, but too "
            f"much is left to be sure of a name."
        )
    return "Something is missing that none of the known effects explains."


def verdict_lines(found: Diagnosis) -> list[str]:
    """Return the verdict first, then what it rests on, a line each."""
    lines = [headline(found)]
    lines += [line for effect in found.effects for line in _effect(effect)]
    if found.verdict != "none":
        lines.append(found.where)
    lines.append(gap_sentence(found))
    if found.unexplained and found.verdict == "effects":
        lines.append("more than chance is left beside what is named: something else is missing, too")
    if found.audit.cannot_see:
        lines.append("these presses could not show: " + ", ".join(found.audit.cannot_see))
    lines += [f"{finding.severity}: {finding.text}. {finding.advice}".rstrip() for finding in found.findings]
    lines += [f"next: {press}" for press in found.next_presses]
    return lines


def verdict_sentences(found: Diagnosis) -> list[str]:
    """What the verdict says and what it rests on, for the page."""
    lines = [] if found.verdict == "none" else [capital(found.where) + "."]
    for e in found.effects:
        text = (
            f"{capital(e.name)} ({EFFECTS[e.name].meaning}): {e.gain:.0f} nats on presses not "
            f"fitted to (p = {e.p_value:.2g})."
        )
        if len(e.consistent_with) > 1:
            text += f" These presses cannot tell it from {_and(e.consistent_with[1:])}; {e.name} is what was added."
        lines.append(text)
    if found.verdict == "none" and found.found.rounds and found.found.rounds[0]:
        best = found.found.rounds[0][0]
        lines.append(
            f"The effect that does best, {best.name}, gains {best.gain:.1f} nats; {best.limit:.1f} are asked for."
        )
    lines.append(capital(gap_sentence(found)) + ".")
    if found.unexplained and found.verdict == "effects":
        lines.append("More than chance is left beside what is named: something else is missing, too.")
    if found.audit.cannot_see:
        lines.append(f"These presses could not show {_and(found.audit.cannot_see)}; why not, is said below.")
    new = (
        "The new calibration has what was named, fitted once more to all presses. The old one stays as it is."
    )
    return [*lines, new if found.effects else "The calibration written is the given one, unchanged."]


def gap_sentence(found: Diagnosis) -> str:
    """Return the gap on presses that nobody has fitted."""
    gap = found.gap
    if not len(gap.errors):
        return "no press was kept for the end"
    where = f"on {len(gap.errors)} presses that nobody has fitted"
    noise = f"(noise {gap.floor:.3g})"
    if found.verdict != "effects":
        return f"{where}, simulated and measured values differ by {gap.before:.3g} counts rms a taxel {noise}"
    if found.only_places:
        return (
            f"{where}, the places that fit best lie {1e3 * gap.slack_before_m:.2f} mm rms "
            f"from the measured ones before, and "
            f"{1e3 * gap.slack_after_m:.2f} mm after; the error is {gap.before:.3g} counts "
            f"before and {gap.after:.3g} after {noise}"
        )
    text = f"{where}, the error falls from {gap.before:.3g} to {gap.after:.3g} counts rms a taxel {noise}"
    if not np.isfinite(gap.closed):
        return text + ": no gap there that what was named could close"
    low, high = gap.interval
    return text + f": {100 * gap.closed:.0f} % of the gap is closed ({100 * low:.0f} to {100 * high:.0f} %)"


def capital(text: str) -> str:
    """Return a sentence's beginning."""
    return text[:1].upper() + text[1:]


def _and(words: tuple[str, ...]) -> str:
    return words[0] if len(words) == 1 else ", ".join(words[:-1]) + " and " + words[-1]


def _effect(effect: NamedEffect) -> Iterator[str]:
    yield f"{effect.name} (p = {effect.p_value:.3g}; explains {100 * effect.share:.0f} % of the excess)"
    for name, value in effect.parameters.items():
        array = np.asarray(value)
        if name not in effect.intervals:
            continue
        low, high = effect.intervals[name]
        if array.ndim == 0 and low < high:
            yield f"    {name} {float(array):.4g} ({float(low):.4g} to {float(high):.4g})"
        elif array.ndim and (array != array[0]).any():
            yield f"    {name} {len(array)} values, {float(np.min(array)):.3g} to {float(np.max(array)):.3g}"
    if effect.at_bound:
        yield f"    {' and '.join(effect.at_bound)} at the bound of what is allowed: the best value may lie beyond"
