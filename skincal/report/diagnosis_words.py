"""The text of a diagnosis, for the terminal and the page."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Literal

import numpy as np

from skincal.effects import EFFECTS

if TYPE_CHECKING:
    from skincal.diagnosis.diagnosis import Diagnosis, NamedEffect

Tone = Literal["good", "found", "attention"]


def tone(found: Diagnosis) -> Tone:
    """Return the tone that sets the colour of the verdict: nothing to do, something found, or something open."""
    if found.verdict == "none":
        return "good"
    return "found" if found.verdict == "effects" and not found.unexplained else "attention"


def headline(found: Diagnosis) -> str:
    """Return the verdict in one sentence."""
    if found.verdict == "none":
        return "These presses show no missing effect."
    if found.verdict == "effects":
        return "Missing: " + " and ".join(" or ".join(e.consistent_with) for e in found.effects) + "."
    if found.taken_back and found.gap.refutes:
        return (
            f"Something is missing. {_and(found.taken_back)} would explain it, but makes "
            f"the error on the test presses larger."
        )
    if found.taken_back:
        return (
            f"Something is missing. {_and(found.taken_back)} explains a part of it, but "
            f"too much remains unexplained for a reliable name."
        )
    return "Something is missing that no known effect explains."


def verdict_lines(found: Diagnosis) -> list[str]:
    """Return the verdict and its evidence, line by line."""
    lines = [headline(found)]
    lines += [line for effect in found.effects for line in _effect(effect)]
    if found.verdict != "none":
        lines.append(found.where)
    lines.append(gap_sentence(found))
    if found.unexplained and found.verdict == "effects":
        lines.append("the named effects leave more than chance: something else is missing, too")
    if found.audit.cannot_see:
        lines.append("these presses cannot show: " + ", ".join(found.audit.cannot_see))
    lines += [
        f"{finding.severity}: {finding.text.rstrip('.')}. {finding.advice}".rstrip()
        for finding in found.findings
    ]
    lines += [f"next: {press}" for press in found.next_presses]
    return lines


def verdict_sentences(found: Diagnosis) -> list[str]:
    """Return the verdict and its evidence as sentences for the page."""
    lines = [] if found.verdict == "none" else [capital(found.where) + "."]
    for e in found.effects:
        text = (
            f"{capital(e.name)} ({EFFECTS[e.name].meaning}): {e.gain:.0f} nats on "
            f"held-out presses (p = {e.p_value:.2g})."
        )
        if len(e.consistent_with) > 1:
            text += f" These presses cannot distinguish it from {_and(e.consistent_with[1:])}; {e.name} was added."
        lines.append(text)
    if found.verdict == "none" and found.found.rounds and found.found.rounds[0]:
        best = found.found.rounds[0][0]
        lines.append(
            f"The best candidate, {best.name}, gains {best.gain:.1f} nats; {best.limit:.1f} are required."
        )
    lines.append(capital(gap_sentence(found)) + ".")
    if found.unexplained and found.verdict == "effects":
        lines.append("The named effects leave more than chance: something else is missing, too.")
    if found.audit.cannot_see:
        lines.append(
            f"These presses cannot show {_and(found.audit.cannot_see)}; the reasons are given below."
        )
    return [*lines, _new_calibration(found)]


def _new_calibration(found: Diagnosis) -> str:
    added = ["the named effects"] if found.effects else []
    added += ["a contact law"] if found.contact_law is not None else []
    if not added:
        return "The calibration is written unchanged."
    return (
        f"The new calibration has {' and '.join(added)}, refitted to all presses. The old one is not changed."
    )


def gap_sentence(found: Diagnosis) -> str:
    """Return the sentence about the gap on the test presses."""
    gap = found.gap
    if not len(gap.errors):
        return "there are no test presses"
    where = f"on {len(gap.errors)} test presses"
    noise, unit = f"(noise {gap.floor:.3g})", found.calibration.sensor.unit_label
    if found.verdict != "effects" and found.contact_law is not None:
        return (
            f"{where}, the contact law brings the error from {gap.before:.3g} to {gap.after:.3g} {unit} rms per taxel "
            f"{noise}"
        )
    if found.verdict != "effects":
        return (
            f"{where}, simulated and measured values differ by {gap.before:.3g} {unit} rms per taxel {noise}"
        )
    if found.only_places:
        return (
            f"{where}, the best-fitting positions lie {1e3 * gap.slack_before_m:.2f} mm rms "
            f"from the measured ones before, and "
            f"{1e3 * gap.slack_after_m:.2f} mm after; the error is {gap.before:.3g} {unit} "
            f"before and {gap.after:.3g} after {noise}"
        )
    text = f"{where}, the error falls from {gap.before:.3g} to {gap.after:.3g} {unit} rms per taxel {noise}"
    if not np.isfinite(gap.closed):
        return text + ": there is no gap that the named effects could close"
    low, high = gap.interval
    return text + f": {100 * gap.closed:.0f} % of the gap is closed ({100 * low:.0f} to {100 * high:.0f} %)"


def capital(text: str) -> str:
    """Return a text with a capital first letter."""
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
        yield f"    {' and '.join(effect.at_bound)} at the bound of the range: the best value may lie beyond"
