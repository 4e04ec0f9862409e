"""Bound on the gain of a candidate by errors in the equations of effects that the model has already."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from skincal.effects import effect
from skincal.inference.blocks import Blocks, Whitened
from skincal.inference.constants import CONSTANTS as C
from skincal.inference.fit import NB, Fitted, Fitter
from skincal.inference.slopes import Slopes
from skincal.model.arrays import FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class EquationErrors:
    """Equation errors of the effects in a fit, over M observations of presses.

    Attributes:
        fitter: of the session.
        w: the model's columns, whitened.
        each: (M, J) error of each equation, one standard deviation, less what base and presses absorb.
        cells: (M, J) for each equation: equal numbers where all its inputs are about equal.
        phases: (M,) number of the phase of the press.
    """

    fitter: Fitter
    w: Whitened
    each: Sequence[FloatArray]
    cells: Sequence[IntArray]
    phases: IntArray

    @classmethod
    def of(cls, fitter: Fitter, fit: Fitted, w: Whitened) -> EquationErrors | None:
        """Compute those of a fit; None if no equation has an error."""
        if not w.own.shape[2]:
            return None
        columns = np.concatenate([w.columns.dense[..., :NB], w.own], axis=2)
        plain = replace(w, columns=Slopes.of(columns), own=w.own[..., :0])
        b = fitter.blocks(plain, fit.state.move)
        h = b.h.sum(axis=0)
        prior, _ = fitter.prior(fit.state, ())
        base = np.linalg.solve(h[:NB, :NB] + np.diag(prior), h[:NB, NB:])
        ways = np.vstack([-base, np.eye(w.own.shape[2])]).T
        pressed = fitter.press >= 0
        phases = np.stack([fitter.press[pressed], fitter.phase[pressed]])
        phases = np.unique(phases, axis=1, return_inverse=True)[1].ravel()
        each = [without_nuisances(fitter, b, plain, change) for change in ways]
        return cls(fitter, w, each, cells_of(fitter, fit), phases)

    def explainable_gain(self, blocks: Blocks, change: FloatArray, curvature: float) -> float:
        """Bound the gain of a candidate by these errors [nats].

        Args:
            blocks: with the columns of the candidate.
            change: (n,) step of the candidate's columns and of those that follow it.
            curvature: of its gain: squares of its change, and the cost where the model follows.
        """
        new = without_nuisances(self.fitter, blocks, self.w, change)
        return explainable_gain(self.each, self.cells, without_errors(self.each, self.phases, new), curvature)


def without_nuisances(fitter: Fitter, blocks: Blocks, w: Whitened, step: FloatArray) -> FloatArray:
    """Compute the change (M, J) by a step in presses, less what place, force and image error of each press absorb."""
    pressed = fitter.press >= 0
    press, signal = fitter.press[pressed], w.signal[pressed]
    x = w.columns.times(step)[pressed]
    x -= np.einsum("njk,nk->nj", w.press[pressed], (blocks.moves @ step)[press])
    square = np.maximum(_summed(press, signal**2), 1e-12)
    part = (1 - 1 / np.sqrt(1 + fitter.priors.image**2 * square)) / square
    return x - signal * (part * _summed(press, signal * x))[press]


def cells_of(fitter: Fitter, fit: Fitted) -> list[IntArray]:
    """Number the cells (M, J) of each effect with an equation error: equal where its inputs are about equal.

    Effects with memory have a cell for each moment, and effects of place one for each taxel and moment.
    """
    pressed = fitter.press >= 0
    felt = np.maximum(fitter.forward.mean @ fit.prediction.values, 0.0)[pressed]
    felt /= np.maximum(felt.max(axis=1, keepdims=True), 1e-12)
    force = fitter.force[pressed][:, None]
    moment, none = np.arange(len(force))[:, None], np.zeros(felt.shape, dtype=np.int64)
    cells = {
        "load": _interval_of(force / max(float(force.max()), 1e-12)) * C.parts + _interval_of(felt),
        "place": moment * felt.shape[1] + np.arange(felt.shape[1]),
        "session": _interval_of(moment / len(moment)) + none,
        "history": moment + none,
    }
    return [cells[effect(n).errs_over] for n in fit.prediction.state.effects if effect(n).equation_error]


def explainable_gain(
    errors: Sequence[FloatArray], cells: Sequence[IntArray], new: FloatArray, curvature: float
) -> float:
    """Bound the gain of a candidate by the equation errors of other effects [nats].

    An equation is wrong as a function of its inputs: within a cell by one factor, up to two standard deviations, with
    the sign that makes it look most like the candidate.

    Args:
        errors: (M, J) of each equation, one standard deviation.
        cells: (M, J) of each.
        new: (M, J) change by the candidate that the model cannot follow.
        curvature: of its gain: squares of that change, and the cost where the model follows.
    """
    along = 0.0
    for one, alike in zip(errors, cells, strict=True):
        along += float(np.abs(np.bincount(alike.ravel(), (new * one).ravel())).sum()) ** 2
    return 0.5 * C.alike**2 * along / max(curvature, 1e-300)


def without_errors(errors: Sequence[FloatArray], phases: IntArray, new: FloatArray) -> FloatArray:
    """Remove from a change (M, J) its projection on equation errors (M, J), each with one factor in each phase (M,)."""
    u = np.stack(errors, axis=-1)
    h = _summed(phases, np.einsum("mja,mjb->mab", u, u)) + np.eye(len(errors))
    follow = np.linalg.solve(h, _summed(phases, np.einsum("mja,mj->ma", u, new))[..., None])[..., 0]
    return new - np.einsum("mja,ma->mj", u, follow[phases])


def _interval_of(x: FloatArray) -> IntArray:
    """Return the index of the interval, of equal ones from 0 to 1, that each number lies in."""
    return np.minimum((C.parts * x).astype(np.int64), C.parts - 1)


def _summed(of: IntArray, values: FloatArray) -> FloatArray:
    """Sum rows with the same number."""
    out = np.zeros((int(of.max(initial=-1)) + 1, *values.shape[1:]))
    np.add.at(out, of, values)
    return out
