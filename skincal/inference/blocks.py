"""Whitened observations, press by press, with what each press has for itself integrated out.

Of a press p with whitened columns C, residual e and nuisance columns N with prior precision L (shift of the contact,
scale of the force, an error of the image, of the equation of each effect), G = N'N + L::

    H_p = C'C - C'N G^-1 N'C,   b_p = C'e - C'N G^-1 (N'e - L m),   chi_p = e'e + m'Lm - v'G^-1 v,  v = N'e - L m

with m where the nuisances are now. All that follows, fits, scores, null sessions, is linear algebra on H_p and b_p.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

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
    hs, bs, loss, chi, counts, owner = [], [], [], [], [], []
    constant, by = np.zeros((len(at), 3)), np.zeros((len(at), 3, n))
    drawn, drawn_chi = [], []
    phases = np.unique(phase)
    for rows in block_rows(press):
        p = int(press[rows[0]])
        c, e = w.columns[rows].reshape(len(rows) * taxels, n), w.residual[rows].ravel()
        look = None if draws is None else draws[rows].reshape(len(e), -1).copy()
        count = int(w.seen[rows].sum())
        extra = 2 * float(w.log_sd[rows][w.seen[rows]].sum())
        if p < 0:
            hs.append(c.T @ c)
            bs.append(c.T @ e)
            own = float(e @ e)
            if look is not None:
                drawn.append(c.T @ look)
                drawn_chi.append((look**2).sum(axis=0))
        else:
            image = np.zeros((len(rows), taxels, taxels))
            image[:, np.arange(taxels), np.arange(taxels)] = w.signal[rows]
            image = image[:, :, np.abs(w.signal[rows]).max(axis=0) > 0.3]
            parts = [w.press[rows], image]
            parts += [w.own[rows] * (phase[rows] == f)[:, None, None] for f in phases if w.own.shape[2]]
            big = np.concatenate(parts, axis=2).reshape(len(e), -1)
            lam = np.full(big.shape[1], 1 / C.equation**2)
            lam[:3], lam[3 : 3 + image.shape[2]] = precision, 1 / C.image**2
            m = np.zeros(big.shape[1])
            m[:3] = at[p]
            g = big.T @ big
            g[np.diag_indices_from(g)] += lam
            chol = np.linalg.cholesky(g)
            v = big.T @ e - lam * m
            right = np.linalg.solve(chol, np.concatenate([big.T @ c, v[:, None]], axis=1))
            left, z = right[:, :n], right[:, n]
            hs.append(c.T @ c - left.T @ left)
            bs.append(c.T @ e - left.T @ z)
            own = float(e @ e + m @ (lam * m) - z @ z)
            extra += 2 * float(np.log(np.diag(chol)).sum()) - float(np.log(lam).sum())
            back = np.linalg.solve(chol.T, right)
            constant[p], by[p] = back[:3, n], back[:3, :n]
            if look is not None and rng is not None:
                look += big @ (rng.standard_normal((big.shape[1], look.shape[1])) / np.sqrt(lam)[:, None])
                zz = np.linalg.solve(chol, big.T @ look)
                drawn.append(c.T @ look - left.T @ zz)
                drawn_chi.append((look**2).sum(axis=0) - (zz**2).sum(axis=0))
        chi.append(own)
        loss.append(own + extra)
        counts.append(count)
        owner.append(p)
    return Blocks(
        np.array(hs), np.array(bs), np.array(loss), np.array(chi), np.array(counts), np.array(owner), (constant, by),
        np.array(drawn), np.array(drawn_chi),
    )  # fmt: skip
