"""How well base and effects are known, with the errors that presses share: of positions, gains and forces.

A fit integrates these out (:mod:`skincal.fitting.shared`). The search for effects leaves them to the numbers that each
press has for itself, which is quick and does for names, but makes pose, E and S look better known than they are. So
they are put in at the end, as columns beside those that were fitted.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skincal.calibrate.problem import joint_angles
from skincal.dataset import Dataset
from skincal.effects import InputEffect, LawEffect, effect
from skincal.fitting.shared import smooth_field
from skincal.fitting.sigmas import GAIN_SIGMA
from skincal.inference.constants import CONSTANTS as C
from skincal.inference.fit import Fitted, Fitter
from skincal.inference.forward import Prediction
from skincal.inference.slopes import Slopes
from skincal.model.arrays import FloatArray

GAINS = "skin.scale_offset_per_n"
"""What stands for gains of taxels in ranges; an effect that replaces it has them itself."""
_TURN = 2
"""The first two functions of a field are its gradient along either axis."""


def covariance(dataset: Dataset, fitter: Fitter, fit: Fitted) -> FloatArray:
    """Mean squares (n, n) of base, law and effects about a fit, with errors that presses share.

    Errors of positions and gains have priors, and presses tell of them what they can. What the equation of an effect
    errs by they do not: no list of shapes has the true one in it. So each shape counts with all that it would move.

    Args:
        dataset: the session.
        fitter: of it.
        fit: of base and effects.
    """
    seen, free, n = fit.prediction, fit.free, fit.numbers
    field, told = _field(dataset, fitter, fit)
    parts = [fitter.columns(seen, free), Slopes.of(field)]
    if not any(effect(f.effect).replaces_range == GAINS for f in free):
        taxels = seen.values.shape[1]
        parts += [Slopes.of_taxel(GAIN_SIGMA * seen.values[:, j], j, taxels) for j in range(taxels)]
    done = {name: fitter.effect_values(seen, name) for name in seen.state.effects}
    errors = [C.equation * d * x for d in done.values() for x in fitter.shared_error_modes(seen)]
    known = sum(len(p) for p in parts)
    columns = Slopes.joined([*parts, *(Slopes.of(e[..., None]) for e in errors)])
    own, _ = fitter.equation_errors(seen, word=True)
    wide = fitter.linearised(seen, free, fitter.whitened(seen, columns, own), len(columns) - n)
    h = wide.blocks.h.sum(axis=0) + np.diag(wide.prior)
    inverse = np.linalg.inv(h[:known, :known])[:n]
    moved = inverse @ h[:known, known:]
    out = inverse[:, :n] + moved @ moved.T
    out[:2, :2] += np.diag(told**2)
    force = dataset.meta.force.scale_sigma if dataset.meta.force is not None else 0.0
    # Were all forces larger by a factor, the same images would come from that much more E, and less S.
    ways = [
        force * _OF_FORCE,
        np.array([0.0, C.law_scale]),
        *(_way(fitter, seen, name, d) for name, d in done.items()),
    ]
    return out + np.pad(sum(np.outer(w, w) for w in ways), ((3, n - 5), (3, n - 5)))


_OF_FORCE = np.array([1.0, -1.0])


def _way(fitter: Fitter, seen: Prediction, name: str, done: FloatArray) -> FloatArray:
    """(2,) how far logarithms of E and S may lie from where an effect does nothing, one standard deviation.

    Where that is, its equation says, and another one of the same effect says it elsewhere: at rising force or in the
    middle of a loop, at once or after a while, at rest or at the speed of presses.
    """
    own, values = effect(name), seen.state.effects[name]
    if isinstance(own, LawEffect):
        return own.zero_error * np.array([own.law(own.checked(values, done.shape[1])).exponent - 1, 0.0])
    press = fitter.forward.row[on := fitter.forward.samples.touching & (fitter.forward.row >= 0)]
    now, did = (np.bincount(press, x[on].sum(axis=1)) for x in (seen.values, done))
    each = (np.abs(did) / np.maximum(now - did, 1e-9))[np.unique(press)]
    size = own.zero_error * float(np.sqrt(np.mean(np.minimum(each, 1.0) ** 2)))
    return size * (_OF_FORCE if isinstance(own, InputEffect) else np.array([0.0, 1.0]))


def _field(dataset: Dataset, fitter: Fitter, fit: Fitted) -> tuple[FloatArray, FloatArray]:
    """Columns (K, J, m) of a smooth error of positions, at one standard deviation, and what a pose is worth (2,) [m].

    A pose is that of the mean error, which is another for contacts of other forces, or of another sample. The size is
    that of the smooth part of how far presses have moved. What of that is a turn of the patch is the angle's; the other
    parts say how large it may be.
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
    shape = fit.prediction.values.shape
    if len(rows) == 0:
        return np.zeros((*shape, 0)), np.zeros(2)
    basis, fading = smooth_field(places, presses.force_n, posture, rows)
    found = np.linalg.lstsq(basis, moves[rows] - moves[rows].mean(axis=0), rcond=None)[0]  # (M, 2)
    if len(found) >= _TURN:
        turn = 0.5 * (found[0, 1] - found[1, 0])
        found[0, 1], found[1, 0] = found[0, 1] - turn, found[1, 0] + turn
    sigma = float(np.sqrt((found**2).sum() / max(found.size - 1, 1)))
    at = np.zeros((len(moves), basis.shape[1]))
    at[rows] = sigma * basis
    row = fitter.forward.row
    by_move = fitter.forward.press_columns(fit.prediction)[..., :2]
    each = np.where((row >= 0)[:, None], at[np.maximum(row, 0)], 0.0)
    columns = np.concatenate([by_move[..., k, None] * each[:, None] for k in range(2)], axis=2)
    other = sigma**2 * (basis.shape[1] * 2 / len(rows) + (fading**2).sum() / 3)
    return columns, np.full(2, np.sqrt(other))
