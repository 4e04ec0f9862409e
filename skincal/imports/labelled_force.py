"""Forces that were not measured but noted: known weights, whose contacts only the taxels show."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from skincal.dataset import IDLE, PHASES
from skincal.dataset.findings import Findings
from skincal.imports.cutting import (
    OFF_SIGMAS,
    ON_SIGMAS,
    activity_of,
    cut_by_taxels,
    cut_numbered,
    stretches,
    widened,
)
from skincal.imports.mapping import Mapping
from skincal.imports.mapping_file import CutRules
from skincal.imports.recording import Cut, FloatArray, Series

MOST: Final = 0.9
"""Part of the contacts in which a noted force is constant; others may have been noted late."""

OFF_PART: Final = 0.1
"""End of a contact within a number, as a part of its image (a tolerance for creep)."""


def is_labelled(series: Series, images: FloatArray, rules: CutRules) -> bool:
    """Return whether the force (M,) was noted: constant within each number, or from start to end of each contact.

    A measured force rises and falls with the images (M, J). One that is 0 between contacts shows itself where they are.
    """
    if rules.by == "plateaus":
        return False
    constant = np.diff(series.force_n) == 0
    if series.press is not None:
        own = [(start, stop) for start, stop in stretches(series) if stop - start > 1]
        return bool(own) and all(constant[start : stop - 1].all() for start, stop in own)
    if np.mean(constant) <= MOST:
        return False
    found, idle = cut_by_taxels(series, images, rules), np.ones(len(series), dtype=bool)
    for one in (*found.spans, *found.rejected):
        idle[one.start : one.stop] = False
    inside = [constant[span.start : span.stop - 1].all() for span in found.spans]
    shows = rules.by == "force" and np.median(series.force_n[idle] if idle.any() else 0.0) <= rules.off_n
    return bool(inside) and bool(np.mean(inside) >= MOST) and not shows


def check_labelled(series: Series, mapping: Mapping, file: str, findings: Findings) -> None:
    """Report that contacts are not cut by a noted force; it has no zero that could be taken off."""
    if not mapping.measures("force_n"):
        return
    got = "one that is constant in each contact and beyond it, like a known weight"
    if mapping.cut.zero_force:
        place = f"{mapping.path.name}, [series], zero_force"
        findings.error(place, "a force that rises and falls with the images", got, "Remove zero_force.")
    if mapping.cut.by == "force" or (series.press is not None and series.phase is None):
        fix = "Contacts are found by the taxels; the force counts in them, and is 0 elsewhere."
        findings.note(f"{file}, force_n", "a force that rises and falls with the images", got, fix)


def in_contact(series: Series, found: Cut) -> Series:
    """Return a series whose force was not measured: kept during contact, and 0 elsewhere."""
    touched = np.zeros(len(series), dtype=bool)
    for span in found.spans:
        touched[span.start : span.stop] = True
    if series.phase is not None:
        touched &= series.phase != PHASES[IDLE]
    return replace(series, force_n=np.where(touched, series.force_n, 0.0))


def cut_labelled(series: Series, images: FloatArray, rules: CutRules, file: str, findings: Findings) -> Cut:
    """Return the presses of a series whose force was noted, by its images (M, J): one per number if it has numbers.

    A number without a rest in it is a contact from its start to its end.
    """
    if series.press is None:
        return cut_by_taxels(series, images, rules)
    if series.phase is not None:
        return cut_numbered(series, rules, file, findings)
    activity = activity_of(images)
    force = np.zeros(len(series))
    for start, stop in stretches(series):
        if series.force_n[start] <= rules.off_n:
            continue
        values = activity.values[start:stop]
        middle = float(np.quantile(values, [0.02, 0.98]).mean())
        low, high = values[values < middle], values[values >= middle]
        rest = float(np.median(low)) if len(low) else activity.rest
        size = float(np.median(high)) - rest
        # Creep and drift change an image, too, but not by more than half of it.
        if size > max(ON_SIGMAS * activity.sigma, float(np.median(high) - activity.rest) / 2):
            force[start:stop] = values - rest
            off = max(OFF_SIGMAS * activity.sigma, OFF_PART * size)
            force[start:stop][force[start:stop] <= off] = 0.0
        else:
            force[start:stop] = 1.0
    series = replace(series, force_n=force, sigma_n=activity.sigma)
    found = cut_numbered(series, replace(rules, off_n=0.0), file, findings)
    return widened(found, activity.values, series.part)
