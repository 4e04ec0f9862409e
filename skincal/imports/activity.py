"""Contacts detected from the taxels, for recordings without a force (weights placed by hand). Pure numerics."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from skincal.imports.cutting import cut
from skincal.imports.mapping import Mapping
from skincal.imports.mapping_file import CutRules
from skincal.imports.recording import FloatArray
from skincal.imports.series import Cut, Series

ON_SIGMAS, OFF_SIGMAS = 8.0, 4.0
"""Thresholds of the sum of the taxels, in standard deviations of its noise at rest, for start and end of a contact."""

LEAST_PART: Final = 0.1
"""And as a part of the strongest contacts (a tolerance for creep and crosstalk of rests)."""


def cut_by_taxels(series: Series, images: FloatArray, rules: CutRules) -> Cut:
    """Return the contacts of a series, by the distance of its images (M, J) from their level at rest."""
    activity = taxel_activity(images)
    low = activity <= np.quantile(activity, 0.95) / 2
    rest = float(np.median(activity[low])) if low.any() else 0.0
    sigma = 1.4826 * float(np.median(np.abs(activity[low] - rest))) if low.any() else 0.0
    top = float(np.quantile(activity, 0.99)) - rest
    on = max(ON_SIGMAS * sigma, LEAST_PART * top)
    found = replace(rules, by="force", on_n=on, off_n=max(OFF_SIGMAS * sigma, on / 2))
    return cut(replace(series, force_n=activity - rest), found)


def taxel_activity(images: FloatArray) -> FloatArray:
    """Return the sum over the taxels of their distance above rest, the lowest tenth of their values, shape (M,)."""
    images = images[:, np.isfinite(images).any(axis=0)]  # without taxels that were never read
    rest = np.nanquantile(images, 0.1, axis=0)
    return np.nansum(np.maximum(images - rest, 0.0), axis=1)


def in_contact(force_n: FloatArray, found: Cut, mapping: Mapping) -> FloatArray:
    """Return the force [N] (M,); one that was not measured is kept during contact and set to 0 elsewhere."""
    quantity = mapping.quantity("force_n")
    if quantity is None or quantity.constant is None:
        return force_n
    touched = np.zeros(len(force_n), dtype=bool)
    for span in found.spans:
        touched[span.start : span.stop] = True
    return np.where(touched, force_n, 0.0)
