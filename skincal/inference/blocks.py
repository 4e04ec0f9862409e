"""Whitened observations, press by press, with what each press has for itself integrated out.

Of a press p with whitened columns C, residual e and nuisance columns N with prior precision L (shift of the contact,
scale of the force, an error of the image, of the equation of each effect), G = N'N + L::

    H_p = C'C - C'N G^-1 N'C,   b_p = C'e - C'N G^-1 (N'e - L m),   chi_p = e'e + m'Lm - v'G^-1 v,  v = N'e - L m

with m where the nuisances are now. All that follows, fits, scores, null sessions, is linear algebra on H_p and b_p.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from skincal.inference.constants import CONSTANTS as C
from skincal.model.arrays import BoolArray, FloatArray, IntArray

IDLE_BLOCKS = 12


@dataclass(frozen=True, eq=False)
class Blocks:
    """B blocks: presses, then stretches of rest.

    Attributes:
        h: (B, n, n).
        b: (B, n).
        loss: (B,) minus twice the logarithm of the likelihood at the present state, but for a constant.
        chi: (B,) squares that are left, over the noise.
        count: (B,) values.
        press: (B,) row of the press, -1 for rest.
        moves: for each press the steps of its three own numbers: constant (3,) and by the columns (3, n).
        free: (B, n, m) columns with nuisances taken out, transposed, for residuals of null sessions; may be empty.
    """

    h: FloatArray
    b: FloatArray
    loss: FloatArray
    chi: FloatArray
    count: IntArray
    press: IntArray
    moves: tuple[FloatArray, FloatArray]
    drawn: FloatArray
    drawn_chi: FloatArray


def block_rows(press: IntArray) -> list[IntArray]:
    """Observations of each block."""
    rows = [np.flatnonzero(press == p) for p in range(int(press.max(initial=-1)) + 1)]
    idle = np.flatnonzero(press < 0)
    rows += [part for part in np.array_split(idle, IDLE_BLOCKS) if len(part)]
    return [r for r in rows if len(r)]


@dataclass(frozen=True, eq=False)
class Whitened:
    """One linearisation: all (N, J, ...) over the noise, robust weights in.

    Attributes:
        residual: (N, J).
        columns: (N, J, n).
        press: (N, J, 3) by the move across and along and the logarithm of the force.
        signal: (N, J) level above rest, as it shows.
        own: (N, J, k) contribution of each effect that is in the model.
        seen: (N, J).
        log_sd: (N, J) logarithm of the noise.
    """

    residual: FloatArray
    columns: FloatArray
    press: FloatArray
    signal: FloatArray
    own: FloatArray
    seen: BoolArray
    log_sd: FloatArray


def blocks(
    w: Whitened,
    press: IntArray,
    phase: IntArray,
    at: FloatArray,
    precision: FloatArray,
    draws: FloatArray | None = None,
    rng: np.random.Generator | None = None,
) -> Blocks:
    """Builds them.

    The error of an image is one number a taxel and press, along the signal s alone: it is integrated out first, by
    ``x - s (s'x) (1 - 1 / sqrt(1 + s's / l)) / s's``, after which it is as if there were none.

    Args:
        w: whitened.
        press: (N,) row of the press, -1 at rest.
        phase: (N,).
        at: (P, 3) where each press's own numbers are.
        precision: (3,) of these, beforehand.
        draws: (N, J, S) whitened residuals of S simulated sessions; nuisances are added here.
        rng: for those.
    """
    taxels, n = w.residual.shape[1], w.columns.shape[2]
    lists = [r for r in block_rows(press) if w.seen[r].any()]
    order, begin = np.concatenate(lists), np.concatenate([[0], np.cumsum([len(r) for r in lists])])
    owner = np.array([int(press[r[0]]) for r in lists])
    size = np.diff(begin)
    signal = w.signal[order] * np.repeat(owner >= 0, size)[:, None]
    square = np.add.reduceat(signal**2, begin[:-1], axis=0)
    grown = np.sqrt(1 + square * C.image**2)
    shrink = np.repeat((1 - 1 / grown) / np.maximum(square, 1e-12), size, axis=0) * signal

    def freed(x: FloatArray) -> FloatArray:
        """(N, J, k), in the order of blocks, without the error of the image."""
        part = np.add.reduceat(signal[..., None] * x, begin[:-1], axis=0)
        return x - shrink[..., None] * np.repeat(part, size, axis=0)

    phases = [phase[order] == f for f in np.unique(phase[press >= 0])]
    own = (
        np.concatenate([w.own[order] * f[:, None, None] for f in phases], axis=2)
        if w.own.shape[2]
        else w.own[order]
    )
    columns, residual = freed(w.columns[order]), freed(w.residual[order][..., None])[..., 0]
    nuisance = freed(np.concatenate([w.press[order], own], axis=2))
    lam = np.full(nuisance.shape[2], 1 / C.equation**2)
    lam[:3] = precision
    look = None
    if draws is not None and rng is not None:
        look = draws[order]
        errors = rng.standard_normal((len(lists), taxels, look.shape[2])) * C.image
        look += signal[..., None] * np.repeat(errors, size, axis=0)
        look = freed(look)
    seen, log_sd = w.seen[order], np.where(w.seen, w.log_sd, 0.0)[order]
    count = np.add.reduceat(seen.sum(axis=1), begin[:-1])
    loss = 2 * np.add.reduceat(log_sd.sum(axis=1), begin[:-1]) + 2 * np.log(grown).sum(axis=1)
    chi = np.zeros(len(lists))
    hs, bs = np.zeros((len(lists), n, n)), np.zeros((len(lists), n))
    constant, by = np.zeros((len(at), 3)), np.zeros((len(at), 3, n))
    sessions = 0 if look is None else look.shape[2]
    drawn, drawn_chi = (
        np.zeros((len(lists) if sessions else 0, n, sessions)),
        np.zeros((len(lists) if sessions else 0, sessions)),
    )
    for k, p in enumerate(owner.tolist()):
        part = slice(begin[k], begin[k + 1])
        c, e = columns[part].reshape(size[k] * taxels, n), residual[part].ravel()
        own_draws = np.zeros((len(e), 0)) if look is None else look[part].reshape(len(e), -1)
        all_ = np.concatenate([c, e[:, None], own_draws], axis=1)
        cross = c.T @ all_
        squares = np.einsum("rs,rs->s", all_[:, n:], all_[:, n:])
        if p >= 0:
            big = nuisance[part].reshape(len(e), len(lam))
            m = np.zeros(len(lam))
            m[:3] = at[p]
            g = big.T @ big
            g[np.diag_indices_from(g)] += lam
            chol = np.linalg.cholesky(g)
            right = big.T @ all_
            right[:, n] -= lam * m
            if sessions and rng is not None:
                drawn_m = rng.standard_normal((len(lam), sessions)) / np.sqrt(lam)[:, None]
                lift = big @ drawn_m
                cross[:, n + 1 :] += c.T @ lift
                squares[1:] += 2 * np.einsum("rs,rs->s", all_[:, n + 1 :], lift) + np.einsum(
                    "rs,rs->s", lift, lift
                )
                right[:, n + 1 :] += big.T @ lift
            z = solve_triangular(chol, right, lower=True, check_finite=False)
            cross -= z[:, :n].T @ z
            squares -= np.einsum("rs,rs->s", z[:, n:], z[:, n:])
            squares[0] += m @ (lam * m)
            loss[k] += 2 * float(np.log(np.diag(chol)).sum()) - float(np.log(lam).sum())
            step = solve_triangular(chol, z[:, : n + 1], lower=True, trans=1, check_finite=False)
            constant[p], by[p] = step[:3, n], step[:3, :n]
        hs[k], bs[k], chi[k] = cross[:, :n], cross[:, n], squares[0]
        if sessions:
            drawn[k], drawn_chi[k] = cross[:, n + 1 :], squares[1:]
    return Blocks(hs, bs, loss + chi, chi, count, owner, (constant, by), drawn, drawn_chi)
