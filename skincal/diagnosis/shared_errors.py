"""Add errors that all presses share, of positions, gains, forces and equations, to the covariance of a joint fit.

A fit integrates these errors out (:mod:`skincal.fitting.shared`). The search for effects has only the nuisance
parameters of each press. That is fast and sufficient for naming, but makes pose, E and S look too certain. So the
shared errors are added at the end, as further columns next to those of the fitted parameters.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skincal.calibrate.problem import joint_angles
from skincal.dataset import Dataset
from skincal.effects import InputEffect, LawEffect, effect
from skincal.fitting.shared import PER_FORCE_ERROR, smooth_field
from skincal.fitting.sigmas import GAIN_SIGMA
from skincal.inference.constants import CONSTANTS as C
from skincal.inference.fit import Fitted, Fitter
from skincal.inference.forward import StatePrediction
from skincal.inference.slopes import Slopes
from skincal.model.arrays import FloatArray

GAINS = "skin.scale_offset_per_n"
"""Range that covers the gains of taxels; an effect that replaces it fits the gains itself."""
_GRADIENT = 2
"""The first two basis functions of the position field are its gradient along either axis."""


def posterior_covariance(dataset: Dataset, fitter: Fitter, fit: Fitted) -> FloatArray:
    """Return the covariance (n, n) of base, contact law and effect parameters, shared errors included.

    Errors of positions and gains are nuisance parameters with priors, which the presses inform. The errors of an
    effect's equation are not estimated, because no list of shapes contains the true one: each shape contributes the
    full shift of the parameters that it would cause.

    Args:
        dataset: the session.
        fitter: fitter of the session.
        fit: fit of base model and effects.
    """
    seen, free, n = fit.prediction, fit.free, fit.numbers
    field, pose_sigma = _position_error_columns(dataset, fitter, fit)
    parts = [fitter.columns(seen, free), Slopes.of(field)]
    if not any(effect(f.effect).replaces_range == GAINS for f in free):
        taxels = seen.values.shape[1]
        parts += [Slopes.of_taxel(GAIN_SIGMA * seen.values[:, j], j, taxels) for j in range(taxels)]
    changes = {name: fitter.effect_values(seen, name) for name in seen.state.effects}
    equation_errors = [
        C.equation * d * shape for d in changes.values() for shape in fitter.shared_error_modes(seen)
    ]
    estimated = sum(len(p) for p in parts)
    columns = Slopes.joined([*parts, *(Slopes.of(e[..., None]) for e in equation_errors)])
    own, _ = fitter.equation_errors(seen, word=True)
    system = fitter.linearised(seen, free, fitter.whitened(seen, columns, own), len(columns) - n)
    h = system.blocks.h.sum(axis=0) + np.diag(system.prior)
    inverse = np.linalg.inv(h[:estimated, :estimated])[:n]
    shifts = inverse @ h[:estimated, estimated:]
    covariance = inverse[:, :n] + shifts @ shifts.T
    covariance[:2, :2] += np.diag(pose_sigma**2)
    # Shifts of log E and log S by one standard deviation of each remaining error.
    scale_shifts = [
        dataset.meta.force_scale_sigma * PER_FORCE_ERROR,
        np.array([0.0, C.law_scale]),
        *(_zero_point_shift(fitter, seen, name, change) for name, change in changes.items()),
    ]
    return covariance + np.pad(sum(np.outer(x, x) for x in scale_shifts), ((3, n - 5), (3, n - 5)))


def _zero_point_shift(fitter: Fitter, seen: StatePrediction, name: str, change: FloatArray) -> FloatArray:
    """Return the shift (2,) of log E and log S by one standard deviation of the zero point of an effect.

    The zero point is where the effect changes nothing: at rising force or in the middle of a loop, at once or after a
    while, at rest or at the speed of the presses. Another equation of the same effect would put it elsewhere.
    """
    own, values = effect(name), seen.state.effects[name]
    if isinstance(own, LawEffect):
        return own.zero_error * np.array([own.law(own.checked(values, change.shape[1])).exponent - 1, 0.0])
    row = fitter.forward.row
    touching = fitter.forward.samples.touching & (row >= 0)
    press = row[touching]
    total, changed = (np.bincount(press, x[touching].sum(axis=1)) for x in (seen.values, change))
    relative = (np.abs(changed) / np.maximum(total - changed, 1e-9))[np.unique(press)]
    size = own.zero_error * float(np.sqrt(np.mean(np.minimum(relative, 1.0) ** 2)))
    return size * (PER_FORCE_ERROR if isinstance(own, InputEffect) else np.array([0.0, 1.0]))


def _position_error_columns(dataset: Dataset, fitter: Fitter, fit: Fitted) -> tuple[FloatArray, FloatArray]:
    """Return the columns of a smooth field of position errors, and the standard deviation of the pose by it.

    The amplitude of the field is that of the smooth part of the fitted moves, without their rotation, which belongs to
    the angle of the pose. The mean of the field differs for contacts of other forces or of another sample; this makes
    the pose uncertain.

    Returns:
        Columns (K, J, m) [counts] at one standard deviation of each basis function; standard deviations (2,) [m].
    """
    presses, moves = dataset.presses, fit.state.move[:, :2]
    pose, surface = replace(fit.state.pose, alpha_rad=0.0), fitter.forward.surface
    step = 1e-4
    points, _ = surface.wrap(pose, np.array([[0.0, 0.0], [step, 0.0], [0.0, step]]))
    places = (presses.position_m - points[0]) @ ((points[1:] - points[0]) / step).T
    joints = joint_angles(presses)
    posture = np.zeros((len(places), 0)) if joints is None else joints
    rows = np.unique(fitter.press[fitter.press >= 0])
    rows = rows[np.isfinite(places[rows]).all(axis=1) & (rows < len(moves))]
    if len(rows) == 0:
        return np.zeros((*fit.prediction.values.shape, 0)), np.zeros(2)
    basis, fading = smooth_field(places, presses.force_n, posture, rows)
    smooth = np.linalg.lstsq(basis, moves[rows] - moves[rows].mean(axis=0), rcond=None)[0]  # (M, 2)
    if len(smooth) >= _GRADIENT:
        turn = 0.5 * (smooth[0, 1] - smooth[1, 0])
        smooth[0, 1], smooth[1, 0] = smooth[0, 1] - turn, smooth[1, 0] + turn
    sigma = float(np.sqrt((smooth**2).sum() / max(smooth.size - 1, 1)))
    field = np.zeros((len(moves), basis.shape[1]))
    field[rows] = sigma * basis
    row = fitter.forward.row
    by_move = fitter.forward.press_columns(fit.prediction)[..., :2]
    of_samples = np.where((row >= 0)[:, None], field[np.maximum(row, 0)], 0.0)
    columns = np.concatenate([by_move[..., k, None] * of_samples[:, None] for k in range(2)], axis=2)
    pose_variance = sigma**2 * (basis.shape[1] * 2 / len(rows) + (fading**2).sum() / 3)
    return columns, np.full(2, np.sqrt(pose_variance))
