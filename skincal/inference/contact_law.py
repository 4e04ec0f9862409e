"""The contact law of a calibration, its parameters in a state, and the evidence for a law other than the foundation's.

A state has the power of the stress less 1, and the excess of spreading and relative radius over what elastic layers of
that power have (:mod:`skincal.inference.forward`); the variance of the spreading is in units of half the square of a
quarter of a millimetre. Every fit has these parameters, with the width by which elastic layers differ from the
foundation as their prior. A calibration gets them if they predict held-out presses better. The fourth parameter, the
part of the unprojected pressure in what taxels feel, is in every fit but in no calibration.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np

from skincal.inference.constants import CONSTANTS as C
from skincal.inference.constants import WIDTH
from skincal.inference.fit import Fitted, Fitter, law_bounds
from skincal.inference.forward import BASE, BLUR_M2, CONTACT, LAW, LAW_WAYS, Forward
from skincal.inference.score import Score, folds_of, held_out
from skincal.model import ContactLaw
from skincal.model.arrays import FloatArray, IntArray, as_floats


def law_parameters(law: ContactLaw) -> FloatArray:
    """Return a state's parameters (4,) for a contact law."""
    own = np.array([law.exponent - 1, law.spread_m2 / BLUR_M2, law.radius_scale - 1, 0.0])
    return as_floats(np.linalg.solve(LAW_WAYS, own))


def law_ends(forward: Forward, numbers: FloatArray, covariance: FloatArray) -> tuple[ContactLaw, ContactLaw]:
    """Return the ends of intervals, from a state's parameters and the covariance (n, n) of its fit."""
    own = slice(len(BASE), len(BASE) + len(LAW))
    reach = WIDTH * np.sqrt(np.diag(LAW_WAYS @ covariance[own, own] @ LAW_WAYS.T))
    # Clipped to the range that the bounds of the parameters allow.
    corners = np.array(list(product(*law_bounds()))) @ LAW_WAYS.T
    least, most = corners.min(axis=0), corners.max(axis=0)
    ends = [np.clip(LAW_WAYS @ numbers + side * reach, least, most) for side in (-1, 1)]
    low, high = (as_floats(np.linalg.solve(LAW_WAYS, end)) for end in ends)
    return forward.contact_law(low), forward.contact_law(high)


def law_gain(fit: Fitted, folds: IntArray) -> Score:
    """Score the law's parameters to first order, on held-out presses.

    Args:
        fit: with the law free.
        folds: (B,) fold of each block.
    """
    n, law = len(fit.prior), len(BASE) + np.arange(len(CONTACT))
    others = np.setdiff1d(np.arange(n), law)
    h = fit.blocks.h
    # Expand about the foundation, where the law's parameters are zero.
    b = (fit.blocks.b + h[:, :, law] @ fit.state.law[: len(CONTACT)])[:, :, None]
    pull = fit.pull.copy()
    pull[law] = 0.0
    some = np.ix_(others, others)
    without = held_out(h[:, *some], b[:, others], fit.prior[others], pull[others], folds)
    return Score((held_out(h, b, fit.prior, pull, folds) - without)[:, 0])


def rejected_foundation(fitter: Fitter, fit: Fitted, rng: np.random.Generator) -> Fitted | None:
    """Return the fit with the foundation's law if the session rejects it, else None.

    The evidence must be significant as that of an effect: to first order, then against the foundation's own fit, which
    may be better than slopes say.

    Args:
        fitter: of the session.
        fit: with the law free.
        rng: draws the folds.
    """
    folds = folds_of(fit.blocks, rng)
    if not _is_sure(law_gain(fit, folds)):
        return None
    foundation = _foundation_fit(fitter, fit)
    return (
        foundation
        if _is_sure(Score(fit.held_out_scores(folds) - foundation.held_out_scores(folds)))
        else None
    )


def _is_sure(gain: Score) -> bool:
    return gain.total > C.least_gain and gain.significance > C.sure


def _foundation_fit(fitter: Fitter, fit: Fitted) -> Fitted:
    """Refit the same model with the law of the foundation."""
    held = Fitter(fitter.forward, fitter.counts, fitter.priors)
    held.foundation = True
    law = np.append(np.zeros(len(CONTACT)), fit.state.law[len(CONTACT) :])
    return held.solve(replace(fit.state, law=law), fit.free, steps=C.last_steps)
