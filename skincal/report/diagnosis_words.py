"""A diagnosis in words, for the terminal and the top of the page."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from skincal.diagnose.diagnosis import Diagnosis, NamedEffect


def verdict_lines(found: Diagnosis) -> list[str]:
    """The verdict first, then what it rests on, a line each."""
    lines = [_verdict(found)]
    if found.verdict == "effects":
        lines += [line for effect in found.effects for line in _effect(effect)]
    if found.verdict != "none":
        lines.append(found.where)
    if found.verdict == "unknown" and found.depends_on:
        lines.append(f"it goes along with {found.depends_on}; these shares overlap")
    lines += _gap(found)
    if found.unexplained and found.verdict == "effects":
        near = "no known effect explains it"
        if found.choice.closest is not None:
            name, part = found.choice.closest
            near = f"{name} comes closest, and explains {100 * part:.0f} % of that"
        lines.append(f"{left_words(found)} of the excess residual is left; {near}")
    if found.audit.cannot_see:
        lines.append("these presses could not show: " + ", ".join(found.audit.cannot_see))
    lines += [f"{finding.severity}: {finding.text}. {finding.advice}".rstrip() for finding in found.findings]
    lines += [f"next: {press}" for press in found.next_presses]
    return lines


def left_words(found: Diagnosis) -> str:
    """How much of the excess residual the named effects leave, in words."""
    share = 100 * (1 - found.choice.explained)
    return "less than 1 %" if share < 0.5 else f"{share:.0f} %"


def _verdict(found: Diagnosis) -> str:
    if found.verdict == "none":
        return "Nothing is missing that these presses could show."
    if found.refuted:
        names = " and ".join(one.name for one in found.choice.named)
        return f"Something is missing. {names} would explain it, but puts presses that nobody has fitted further off."
    if found.wide_open:
        names = " and ".join(one.name for one in found.choice.named)
        return f"Something is missing. {names} shows, but with it presses that nobody has fitted stay off."
    if found.verdict == "unknown":
        return unexplained(found)
    names = " and ".join(" or ".join(effect.consistent_with) for effect in found.effects)
    return f"Missing: {names}."


def unexplained(found: Diagnosis) -> str:
    """What to say where something is missing and has no name."""
    if found.audit.cannot_see:
        return (
            "Something is missing that none of the known effects explains, of those that these presses can show; "
            f"{len(found.audit.cannot_see)} others they cannot."
        )
    return "Something is missing that none of the known effects explains."


def _effect(effect: NamedEffect) -> Iterator[str]:
    of = "where presses turn out to be" if effect.by_places else "what was left"
    yield f"{effect.name} (p = {effect.p_value:.3g}; explains {100 * min(effect.share, 1.0):.0f} % of {of})"
    for name, value in effect.parameters.items():
        low, high = effect.intervals[name]
        if value.ndim == 0 and low < high:
            yield f"    {name} {float(value):.4g} ({float(low):.4g} to {float(high):.4g})"
        elif value.ndim and (value != value[0]).any():
            yield f"    {name} {len(value)} values, {float(np.min(value)):.3g} to {float(np.max(value)):.3g}"
    if effect.at_bound:
        yield f"    {' and '.join(effect.at_bound)} at the bound of what is allowed: the best value may lie beyond"


def _gap(found: Diagnosis) -> Iterator[str]:
    gap = found.gap
    base = f"held-out error {gap.before:.3f} counts"
    where = f"(noise {gap.floor:.3f}; {gap.presses} presses nobody fitted)"
    if found.verdict != "effects":
        yield f"{base} {where}"
        return
    if found.only_places:
        moved = f"{1e3 * gap.slack_before_m:.2f} mm rms before, {1e3 * gap.slack_after_m:.2f} after"
        yield f"held-out presses moved by {moved} ({gap.presses} presses nobody fitted)"
        yield f"{base} before, {gap.after:.3f} after (noise {gap.floor:.3f}): places take it up either way"
        return
    if not np.isfinite(gap.closed):
        yield f"{base} before, {gap.after:.3f} after {where}: no gap there that what was named could close"
        return
    low, high = gap.interval
    yield f"{base} before, {gap.after:.3f} after {where}: {100 * gap.closed:.0f} % of the gap closed "
    yield f"    ({100 * low:.0f} to {100 * high:.0f} %)"
