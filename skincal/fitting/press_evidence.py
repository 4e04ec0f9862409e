"""The evidence of presses by a mixture of narrow slacks: what Laplace's approximation misses.

A press may lie anywhere along a thin curved sheet: over the middle of a taxel, or on a ring round it where one taxel
alone answers. There Laplace's approximation, even with the fold of :mod:`skincal.fitting.volume`, is off by some tenths
of a unit a press, always to the same side, and sixty presses together draw E by half of its standard deviation.

A Gaussian slack is a mixture of narrower ones on a lattice,

    N(s; 0, sigma_p²) = sum_c h² N(c; 0, sigma_p² - omega²) N(s; c, omega²),

to 3e-4 for h = 1.5 omega. Within each the image hardly bends, and Laplace's approximation is right. This costs twice
as much as the places of :mod:`skincal.fitting.places`, and more with the errors that presses share. So it is done for
some of the draws only, and what it adds to the log posterior, a smooth function of the parameters, is fitted to these
and added to all.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skincal.fitting.lattice import disc
from skincal.fitting.presses import Places, PressModel, PressStates, half_inverse
from skincal.fitting.types import Floats, Ints
from skincal.fitting.volume import fold_of

SPACING = 1.5
"""Distance of the narrow slacks, in their standard deviation: the mixture is then even to 3e-4."""

BEND = 0.3
"""A narrow slack bends the whitened residual by so much: the slope of a session's log evidence by log E is then within
3 of what those of half of it give, a tenth of a standard deviation; those of twice of it are off by 7."""

WIDEST, NARROWEST = 0.6, 0.06
"""Standard deviation of the narrow slacks in parts of the wide one, at most and at least."""

REACH = 3.3
"""Slacks are looked for up to so many standard deviations."""

MARGIN = 7.0
"""Narrow slacks whose evidence is so much below the press's best one count for nothing."""

_STEPS = 4
_STEP = 0.3
"""Places are moved by this part of the narrow slack for the bend of the residual."""
_FLATTEST = 0.1
"""A curvature is at least this part of Gauss-Newton's."""


@dataclass(frozen=True, eq=False)
class NarrowSlacks:
    """The narrow slacks (N,) that count, of all presses.

    Attributes:
        at: where each press settled in each, at the macro point that it was found for.
        centre_m: (N, 2) where each lies [m].
        omega_m: (N,) its standard deviation [m].
    """

    at: Places
    centre_m: Floats
    omega_m: Floats


def find_narrow_slacks(model: PressModel, places: Places, macro: Floats, sigmas: Floats) -> NarrowSlacks:
    """The narrow slacks that count at one macro point.

    Args:
        model: the presses.
        places: where each press could have been.
        macro: (5,) macro variables.
        sigmas: (6,) in the order of ``HYPER``.
    """
    bend = _bends(model, places, macro, sigmas)
    omega = np.clip(
        np.sqrt(BEND / np.maximum(bend, 1e-30)), NARROWEST * sigmas[0], WIDEST * sigmas[0]
    ).tolist()
    found = [_of_press(model, macro, sigmas, k, one) for k, one in enumerate(omega)]
    press, centre, width, uv, force = (np.concatenate(arrays) for arrays in zip(*found, strict=True))
    return NarrowSlacks(Places(press, uv, force), centre, width)


def _of_press(
    model: PressModel, macro: Floats, sigmas: Floats, k: int, omega_m: float
) -> tuple[Ints, Floats, Floats, Floats, Floats]:
    """The narrow slacks of press ``k`` that count: one press at a time, as they are many before they are chosen."""
    lattice = disc(SPACING * omega_m, REACH * float(sigmas[0]))
    press, width = np.full(len(lattice), k, dtype=np.intp), np.full(len(lattice), omega_m)
    start = np.column_stack([lattice + model.problem.shared.shift_m[press], np.zeros(len(press))])
    evidence, at = _evidence(model, macro, sigmas, press, lattice, width, start)
    kept = evidence > evidence.max() - MARGIN
    return press[kept], lattice[kept], width[kept], at.uv_m[kept], at.nuisance[kept, 2]


def _bends(model: PressModel, places: Places, macro: Floats, sigmas: Floats) -> Floats:
    """Second derivatives (K,) of the whitened residuals by the place [1/m²], about the largest of each press."""
    state = model.settle_at(places, macro[None], sigmas[None])
    weak = 2.0 * fold_of(model, state).half_bend
    bend = np.zeros(len(model.problem))
    np.maximum.at(bend, places.press, weak)
    # Where the weakest direction happens to be straight, another one bends as images of a taxel's size do.
    observation, size = model.problem.observation, float(np.median(model.problem.rig.layout.sizes_m))
    spread = np.sqrt(observation.variance(state.sigmas[:, 2], state.sigmas[:, 3], places.press))
    np.maximum.at(bend, places.press, (state.simulated / spread).max(axis=1) / size**2)
    return bend


def log_evidence(model: PressModel, slacks: NarrowSlacks, points: Floats) -> Floats:
    """Log evidence (W,) of all presses, up to a constant: the one of :func:`skincal.fitting.posterior.press_evidence`.

    Args:
        model: the presses.
        slacks: that count.
        points: (W, 11) macro variables and logarithms of the sigmas.
    """
    out = np.empty(len(points))
    press = slacks.at.press
    first = np.flatnonzero(np.diff(press, prepend=-1))
    for n, point in enumerate(points):
        macro, sigmas = point[:5], np.exp(point[5:])
        start = model.nuisance_at(slacks.at, np.tile(macro, (len(press), 1)))
        evidence, _ = _evidence(model, macro, sigmas, press, slacks.centre_m, slacks.omega_m, start)
        highest = np.maximum.reduceat(evidence, first)
        parts = np.exp(evidence - np.repeat(highest, np.diff(first, append=len(evidence))))
        out[n] = float((highest + np.log(np.add.reduceat(parts, first))).sum())
    return out


def _evidence(
    model: PressModel,
    macro: Floats,
    sigmas: Floats,
    press: Ints,
    centre_m: Floats,
    omega_m: Floats,
    start: Floats,
) -> tuple[Floats, PressStates]:
    """Log evidence (N,) of narrow slacks at one macro point, and the presses settled in them."""
    spreads = np.tile(sigmas, (len(press), 1))
    left = np.maximum(sigmas[0] ** 2 - omega_m**2, (0.1 * sigmas[0]) ** 2)
    spreads[:, 0] = omega_m
    centre = centre_m + model.problem.shared.shift_m[press]
    state = model.settle(macro, spreads, press, start, iterations=_STEPS, to_rest=False, centre=centre)
    weight = -0.5 * (centre_m**2).sum(axis=1) / left - np.log(left) - np.log(sigmas[1])
    return -0.5 * state.objective + half_inverse(_whole_hessian(model, state))[1] + weight, state


def _whole_hessian(model: PressModel, state: PressStates) -> Floats:
    """Hessians (n, 3, 3) of settled presses with what residuals add by their bend, which Gauss-Newton leaves out.

    A press that reads more or less than its place can give leaves a residual, and a bend of it is part of the curvature
    to first order; over the middle of a taxel all presses have the same sign of it.
    """
    step = _STEP * state.sigmas[:, 0]
    added = np.zeros_like(state.hessian)
    for d in range(2):
        away = np.zeros_like(state.nuisance)
        away[:, d] = step
        bend = model.bends(state, away) / (2 * step)[:, None, None]
        added[:, d] = np.einsum("nj,njd->nd", state.residual, bend)
    added[:, 2, :2] = added[:, :2, 2]
    added[:, 0, 1] = added[:, 1, 0] = 0.5 * (added[:, 0, 1] + added[:, 1, 0])
    # Signals grow as exp(f).
    added[:, 2, 2] = np.einsum("nj,nj->n", state.residual, state.nuisance_slope[..., 2])
    whole = state.hessian + added
    # Where a peak is that flat, it is no peak, and Laplace's approximation is as good as none.
    size = np.sqrt(np.einsum("nii->ni", state.hessian))
    sound = np.linalg.eigvalsh(whole / (size[:, :, None] * size[:, None, :]))[:, 0] > _FLATTEST
    return np.where(sound[:, None, None], whole, state.hessian)
