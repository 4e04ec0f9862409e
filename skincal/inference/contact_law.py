"""The contact law of a calibration, a state's numbers of it, and whether a session shows that they are not zero.

A state's numbers are the power of the stress less 1, and what a spreading and the relative radius have beyond what goes
with it (:mod:`skincal.inference.forward`); the spreading's variance is so many times half the square of a quarter of a
millimetre. Every fit has them, with the width by which elastic layers differ from the foundation as their prior. A
calibration gets them where they predict presses that the fit has not seen. The fourth, how much of the pressure itself
taxels feel, says nothing of the contact: every fit has it, and no calibration.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np

from skincal.inference.constants import CONSTANTS as C
from skincal.inference.fit import Fitted, Fitter, law_bounds
from skincal.inference.forward import BASE, BLUR_M2, CONTACT, LAW, LAW_WAYS, Forward
from skincal.inference.score import Score, folds_of, held_out
from skincal.model import ContactLaw
from skincal.model.arrays import FloatArray, IntArray, as_floats

_WIDTH = 1.96


def numbers_of(law: ContactLaw) -> FloatArray:
    """A state's numbers for a contact law."""
    own = np.array([law.exponent - 1, law.spread_m2 / BLUR_M2, law.radius_scale - 1, 0.0])
    return as_floats(np.linalg.solve(LAW_WAYS, own))


def law_ends(forward: Forward, numbers: FloatArray, covariance: FloatArray) -> tuple[ContactLaw, ContactLaw]:
    """Ends of 95 % intervals, of a state's numbers and the covariance (n, n) of its fit."""
    own = slice(len(BASE), len(BASE) + len(LAW))
    reach = _WIDTH * np.sqrt(np.diag(LAW_WAYS @ covariance[own, own] @ LAW_WAYS.T))
    # Of what the bounds of the numbers allow.
    corners = np.array(list(product(*law_bounds()))) @ LAW_WAYS.T
    least, most = corners.min(axis=0), corners.max(axis=0)
    ends = [np.clip(LAW_WAYS @ numbers + side * reach, least, most) for side in (-1, 1)]
    low, high = (as_floats(np.linalg.solve(LAW_WAYS, end)) for end in ends)
    return forward.contact_law(low), forward.contact_law(high)


def law_gain(fit: Fitted, folds: IntArray) -> Score:
    """What blocks gain to first order by the law's numbers on presses that their fit has not seen.

    Args:
        fit: with the law free.
        folds: (B,) part of each block.
    """
    n, law = len(fit.prior), len(BASE) + np.arange(len(CONTACT))
    others = np.setdiff1d(np.arange(n), law)
    h = fit.blocks.h
    # About the foundation: both models begin where the law's numbers are zero.
    b = (fit.blocks.b + h[:, :, law] @ fit.state.law[: len(CONTACT)])[:, :, None]
    pull = fit.pull.copy()
    pull[law] = 0.0
    some = np.ix_(others, others)
    without = held_out(h[:, *some], b[:, others], fit.prior[others], pull[others], folds)
    return Score((held_out(h, b, fit.prior, pull, folds) - without)[:, 0])


def beaten_foundation(fitter: Fitter, fit: Fitted, rng: np.random.Generator) -> Fitted | None:
    """The same model's fit with the foundation's law, if the session shows that this is not its contact law.

    It is shown as an effect must be: first to first order, then against the foundation's own fit, which may find a
    better place than slopes say.

    Args:
        fitter: of the session.
        fit: with the law free.
        rng: deals the folds.
    """
    folds = folds_of(fit.blocks, rng)
    if not _is_sure(law_gain(fit, folds)):
        return None
    foundation = _foundation_fit(fitter, fit)
    return foundation if _is_sure(Score(fit.predicted(folds) - foundation.predicted(folds))) else None


def _is_sure(gain: Score) -> bool:
    return gain.total > C.least_gain and gain.sure > C.sure


def _foundation_fit(fitter: Fitter, fit: Fitted) -> Fitted:
    """The same model's fit with the law of the foundation."""
    held = Fitter(fitter.forward, fitter.counts, fitter.before)
    held.foundation = True
    law = np.append(np.zeros(len(CONTACT)), fit.state.law[len(CONTACT) :])
    return held.solve(replace(fit.state, law=law), fit.free, steps=C.last_steps)
