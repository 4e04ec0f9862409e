"""How well a refit fits its presses: the loss and the table of slack of the calibration that comes out of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skincal.calibration import Calibration, Finding
from skincal.calibration.calibration import Columns
from skincal.calibration.parts import Loss
from skincal.dataset import Dataset, active_taxels
from skincal.effects.samples import HOLD
from skincal.gap.hypothesis import Hypothesis
from skincal.gap.places import NAME as PLACES
from skincal.gap.reading import Reading
from skincal.inference.session import GapSession
from skincal.model.arrays import BoolArray, FloatArray, IntArray, as_floats

NONE: IntArray = np.zeros(0, dtype=np.int64)
GLITCH, UNKNOWN = "looks like a glitch", "no known place or force, or nothing of its hold that is believed"
"""Why a press was not used."""
LEFT = Finding(
    "misfit",
    "warning",
    "Beside the effects that were named something is missing that none of the known ones explains.",
    "The page and diagnosis.json beside this calibration say where.",
)
OUTDATED = ("misfit", "bad_presses", "glitches", "force_scatter")
"""Findings of a fit that say how its images match; with more in the model they match otherwise."""
OF_PLACES = ("positions_worse", "positions_bent", "slack_bound")
"""Findings of places; with an effect that lives in them they are others."""
_POOR, _NOISY, _POOR_COUNTS = 3.0, 2.0, 0.5
"""A press does not fit whose residual is beyond so many times the middle one, its noise, and so many counts."""
_OWN = 2
"""Numbers that a press has of its own, beside its force: of so many values its place takes up the noise."""


def with_fitted_presses(
    calibration: Calibration,
    found: Hypothesis,
    session: GapSession,
    reading: Reading,
    dataset: Dataset,
    left_out: IntArray = NONE,
    *,
    unexplained: bool = False,
) -> Calibration:
    """A calibration with the loss and the slack of the session that it was fitted to; what is out of date is left out.

    The bound of the valley lies as far above the loss as it did, if it is not a fixed one: a valley is of the sensor's
    parameters, and they keep the width of their intervals. Estimated points are those that the model starts from,
    before effects that move a contact.

    Args:
        calibration: the new one, with those of the calibration that it comes from.
        found: the hypothesis that it is.
        session: what was pressed.
        reading: what was read.
        dataset: the same as the user knows it.
        left_out: rows of presses that look like glitches.
        unexplained: whether something is left that no effect explains.
    """
    left, noise = hold_residuals(found, session, reading, len(dataset.presses))
    used = np.isfinite(left).any(axis=1) & ~np.isin(np.arange(len(left)), left_out)
    if not used.any():
        return calibration
    old, mse = calibration.loss, float(np.nanmean(left[used] ** 2))
    valley = mse + max(0.0, old.valley_mse_counts2 - old.mse_counts2)
    if old.extra.get("valley_bound") == "fixed":
        valley = max(mse, old.valley_mse_counts2)
    values, count = int(np.isfinite(left[used]).sum()), int(used.sum())
    found_again = {
        "presses_dropped": int((~used).sum()),
        "noise_sigma_counts": float(np.sqrt(mse * values / max(values - _OWN * count, 1))),
        "force_sigma_relative": float(np.sqrt((found.places[used, 2] ** 2).mean())),
    }
    extra = {**old.extra, **{name: value for name, value in found_again.items() if name in old.extra}}
    past = OUTDATED + (OF_PLACES if PLACES in found.effects else ())
    kept = tuple(one for one in calibration.findings if one.code not in past)
    findings = (*kept, LEFT) if unexplained else kept
    slack = _slack(found, left, noise, used, dataset, left_out)
    return replace(calibration, loss=Loss(mse, valley, count, extra), slack=slack, findings=findings)


def hold_residuals(
    found: Hypothesis, session: GapSession, reading: Reading, presses: int
) -> tuple[FloatArray, FloatArray]:
    """What is left of the mean image of each hold (P, J), and its noise [counts].

    Both are NaN where nothing was read or is believed.
    """
    rows = np.flatnonzero((session.press >= 0) & (session.phase == HOLD))
    values = found.values(session)
    expected, deviation = reading.expected(values)[rows], reading.deviation(values)[rows]
    known = reading.seen[rows] & np.isfinite(expected)
    weight = session.frames[rows][:, None] * known
    total, variance, share = np.zeros((3, presses, reading.counts.shape[1]))
    at = session.press[rows]
    np.add.at(total, at, weight * np.where(known, reading.counts[rows] - expected, 0.0))
    np.add.at(variance, at, (weight * np.where(known, deviation, 0.0)) ** 2)
    np.add.at(share, at, weight)
    left, noise = (
        np.divide(of, share, out=np.full_like(of, np.nan), where=share > 0)
        for of in (total, np.sqrt(variance))
    )
    return as_floats(left), as_floats(noise)


def _slack(
    found: Hypothesis,
    left: FloatArray,
    noise: FloatArray,
    used: BoolArray,
    dataset: Dataset,
    left_out: IntArray,
) -> Columns:
    count = len(used)
    slack = np.full((count, 2), np.nan)
    rows = np.flatnonzero(used)
    slack[rows] = found.places[rows, :2]
    points, measured = np.full((count, 3), np.nan), dataset.presses.position_m
    rows = rows[np.isfinite(measured[rows]).all(axis=1)]
    points[rows] = dataset.surface().offset(measured[rows], slack[rows, 0], slack[rows, 1])
    rms, usual = np.full((2, count), np.nan)
    rms[used], usual[used] = (np.sqrt(np.nanmean(of[used] ** 2, axis=1)) for of in (left, noise))
    most = np.maximum(_NOISY * usual, max(_POOR * float(np.nanmedian(rms)), _POOR_COUNTS))
    reason = np.where(np.isin(np.arange(count), left_out), GLITCH, UNKNOWN)
    return {
        "press": np.asarray(dataset.presses.press),
        "used": used,
        "reason": np.where(used, "", reason).astype(object),
        "active_taxels": active_taxels(dataset).sum(axis=1).astype(np.int64),
        **{name: points[:, k] for k, name in enumerate(("x_m", "y_m", "z_m"))},
        "slack_across_m": slack[:, 0],
        "slack_along_m": slack[:, 1],
        "residual_rms_counts": rms,
        "good": used & (rms <= most),
    }
