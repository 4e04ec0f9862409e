"""How well a refit fits its presses: the loss and the table of slack of the calibration that comes out of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skincal.calibration import Calibration
from skincal.calibration.calibration import Columns
from skincal.calibration.parts import Loss
from skincal.dataset import Dataset, active_taxels
from skincal.effects.samples import HOLD
from skincal.gap.hypothesis import Hypothesis
from skincal.gap.reading import Reading
from skincal.gap.session import GapSession
from skincal.model.arrays import FloatArray, IntArray, as_floats

GLITCH, UNKNOWN = "looks like a glitch", "no known place or force, or nothing read"
"""Why a press was not used."""
OUTDATED = ("misfit", "bad_presses", "glitches", "force_scatter")
"""Findings of a fit that say how its images match; with more in the model they match otherwise."""
_POOR, _POOR_COUNTS = 3.0, 0.5
"""A press does not fit whose residual is beyond so many times the middle one, and so many counts."""


def with_fitted_presses(
    calibration: Calibration,
    found: Hypothesis,
    session: GapSession,
    reading: Reading,
    dataset: Dataset,
    left_out: IntArray,
) -> Calibration:
    """A calibration with the loss and the slack of the session that it was fitted to; what is out of date is left out.

    The bound of the valley lies as far above the loss as it did: a valley is of the sensor's parameters, and they keep
    the width of their intervals.

    Args:
        calibration: the new one, with those of the calibration that it comes from.
        found: the hypothesis that it is.
        session: what was pressed.
        reading: what was read.
        dataset: the same as the user knows it.
        left_out: rows of presses that look like glitches.
    """
    left = hold_residuals(found, session, reading, len(dataset.presses))
    used = np.isfinite(left).any(axis=1) & ~np.isin(np.arange(len(left)), left_out)
    squares = left[used] ** 2
    old = calibration.loss
    mse = float(np.nanmean(squares)) if used.any() else old.mse_counts2
    loss = Loss(
        mse,
        mse + max(0.0, old.valley_mse_counts2 - old.mse_counts2),
        int(used.sum()),
        {**old.extra, "presses_dropped": int((~used).sum())},
    )
    findings = tuple(one for one in calibration.findings if one.code not in OUTDATED)
    slack = _slack(found, left, used, dataset, left_out)
    return replace(calibration, loss=loss, slack=slack, findings=findings)


def hold_residuals(found: Hypothesis, session: GapSession, reading: Reading, presses: int) -> FloatArray:
    """What is left of the mean image of each hold (P, J) [counts]; NaN where nothing was read or is believed."""
    rows = np.flatnonzero((session.press >= 0) & (session.phase == HOLD))
    expected = reading.expected(found.values(session))
    known = reading.seen[rows] & np.isfinite(expected[rows])
    weight = session.frames[rows][:, None] * known
    total, share = np.zeros((2, presses, reading.counts.shape[1]))
    np.add.at(
        total, session.press[rows], weight * np.where(known, reading.counts[rows] - expected[rows], 0.0)
    )
    np.add.at(share, session.press[rows], weight)
    return as_floats(np.divide(total, share, out=np.full_like(total, np.nan), where=share > 0))


def _slack(
    found: Hypothesis, left: FloatArray, used: np.ndarray, dataset: Dataset, left_out: IntArray
) -> Columns:
    count = len(used)
    slack = np.full((count, 2), np.nan)
    rows = np.flatnonzero(used)
    slack[rows] = found.places[rows, :2]
    points, measured = np.full((count, 3), np.nan), dataset.presses.position_m
    rows = rows[np.isfinite(measured[rows]).all(axis=1)]
    points[rows] = dataset.surface().offset(measured[rows], slack[rows, 0], slack[rows, 1])
    rms = np.full(count, np.nan)
    rms[used] = np.sqrt(np.nanmean(left[used] ** 2, axis=1))
    most = max(_POOR * float(np.nanmedian(rms)), _POOR_COUNTS) if used.any() else 0.0
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
        "good": used & (np.nan_to_num(rms, nan=np.inf) <= most),
    }
