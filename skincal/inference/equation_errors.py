"""What a further effect may owe to errors of the equations of effects that a model has already."""

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
    """Errors of the equations of a fit, over M observations of presses.

    Attributes:
        fitter: of the session.
        w: the model's columns, whitened.
        each: (M, J) what the equation of each effect may err by, less what base and presses take up.
        cells: (M, J) of each: equal where all that its equation is a function of is alike.
        phases: (M,) number of the phase of the press.
    """

    fitter: Fitter
    w: Whitened
    each: Sequence[FloatArray]
    cells: Sequence[IntArray]
    phases: IntArray

    @classmethod
    def of(cls, fitter: Fitter, fit: Fitted, w: Whitened) -> EquationErrors | None:
        """Those of a fit; None where no equation may err."""
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
        each = [beyond_presses(fitter, b, plain, way) for way in ways]
        return cls(fitter, w, each, cells_of(fitter, fit), phases)

    def owed(self, blocks: Blocks, way: FloatArray, curvature: float) -> float:
        """What an effect may gain by them [nats].

        Args:
            blocks: with the columns of the effect.
            way: (n,) what it does: steps of its columns and of those that follow it.
            curvature: of its gain: squares of what it does, and what it costs where the model follows.
        """
        new = beyond_presses(self.fitter, blocks, self.w, way)
        return owed(self.each, self.cells, beyond(self.each, self.phases, new), curvature)


def beyond_presses(fitter: Fitter, blocks: Blocks, w: Whitened, step: FloatArray) -> FloatArray:
    """(M, J) what a step changes in presses, less what each press's place, force and image take up."""
    pressed = fitter.press >= 0
    press, signal = fitter.press[pressed], w.signal[pressed]
    x = w.columns.times(step)[pressed]
    x -= np.einsum("njk,nk->nj", w.press[pressed], (blocks.moves @ step)[press])
    square = np.maximum(_summed(press, signal**2), 1e-12)
    part = (1 - 1 / np.sqrt(1 + fitter.before.image**2 * square)) / square
    return x - signal * (part * _summed(press, signal * x))[press]


def cells_of(fitter: Fitter, fit: Fitted) -> list[IntArray]:
    """(M, J) of each effect whose equation may err: equal where all that it is a function of is alike.

    Of what was before no two moments have the same, and of places no two taxels of any two images.
    """
    pressed = fitter.press >= 0
    felt = np.maximum(fitter.forward.mean @ fit.seen.values, 0.0)[pressed]
    felt /= np.maximum(felt.max(axis=1, keepdims=True), 1e-12)
    force = fitter.force[pressed][:, None]
    moment, none = np.arange(len(force))[:, None], np.zeros(felt.shape, dtype=np.int64)
    cells = {
        "load": _part(force / max(float(force.max()), 1e-12)) * C.parts + _part(felt),
        "place": moment * felt.shape[1] + np.arange(felt.shape[1]),
        "session": _part(moment / len(moment)) + none,
        "history": moment + none,
    }
    return [cells[effect(n).errs_over] for n in fit.seen.state.effects if effect(n).equation_error]


def owed(errors: Sequence[FloatArray], cells: Sequence[IntArray], new: FloatArray, curvature: float) -> float:
    """What an effect may gain by what the equations of others err by [nats].

    An equation errs as a function of what it is a function of: it may be off by one factor wherever that is alike, by
    the part that it may err by, two standard deviations of it, all in the sense in which it is like the new one.

    Args:
        errors: (M, J) of each.
        cells: (M, J) of each: equal where all that its equation is a function of is alike.
        new: (M, J) what the new one does that the model does not follow.
        curvature: of its gain: squares of that, and what it costs where the model follows.
    """
    along = 0.0
    for one, alike in zip(errors, cells, strict=True):
        along += float(np.abs(np.bincount(alike.ravel(), (new * one).ravel())).sum()) ** 2
    return 0.5 * C.alike**2 * along / max(curvature, 1e-300)


def beyond(errors: Sequence[FloatArray], phases: IntArray, new: FloatArray) -> FloatArray:
    """(M, J) what errors of equations (M, J) do not follow, by a factor of each in each phase of a press (M,)."""
    u = np.stack(errors, axis=-1)
    h = _summed(phases, np.einsum("mja,mjb->mab", u, u)) + np.eye(len(errors))
    follow = np.linalg.solve(h, _summed(phases, np.einsum("mja,mj->ma", u, new))[..., None])[..., 0]
    return new - np.einsum("mja,ma->mj", u, follow[phases])


def _part(x: FloatArray) -> IntArray:
    """Which of even parts from 0 to 1 numbers lie in."""
    return np.minimum((C.parts * x).astype(np.int64), C.parts - 1)


def _summed(of: IntArray, values: FloatArray) -> FloatArray:
    """Sums of rows that have the same number."""
    out = np.zeros((int(of.max(initial=-1)) + 1, *values.shape[1:]))
    np.add.at(out, of, values)
    return out
