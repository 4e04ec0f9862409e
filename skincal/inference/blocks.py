"""Whitened observations, press by press, with what each press has for itself integrated out.

Of a press p with whitened columns C, residual e and nuisance columns N with prior precision L (shift of the contact,
scale of the force, an error of the image, of the equation of each effect), G = N'N + L::

    H_p = C'C - C'N G^-1 N'C,   b_p = C'e - C'N G^-1 (N'e - L m),   chi_p = e'e + m'Lm - v'G^-1 v,  v = N'e - L m

with m where the nuisances are now. All that follows, fits, scores, null sessions, is linear algebra on H_p and b_p.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

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
        drawn: (B, n, S) what ``b`` is in simulated sessions.
        drawn_chi: (B, S) and their squares.
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
        own: (N, J, k) what the equation of each effect in the model may err by, at one standard deviation.
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
    ``x'y - (s'x) (s'y) / (l + s's)`` in place of every product x'y over the observations of a taxel.

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
    owner, size = np.array([int(press[r[0]]) for r in lists]), np.diff(begin)
    pressed = np.repeat(owner >= 0, size)[:, None, None]
    phases = [phase == f for f in np.unique(phase[press >= 0])]
    own = [w.own * f[:, None, None] for f in phases] if w.own.shape[2] else []
    nuisance = np.concatenate([w.press, *own], axis=2)[order] * pressed
    lam = np.ones(nuisance.shape[2])
    lam[:3] = precision
    k = len(lam)
    # Nuisances, columns, residual side by side: all that is needed are their products, block by block.
    side = np.concatenate([nuisance, w.columns[order], w.residual[order][..., None]], axis=2)
    signal = w.signal[order] * pressed[..., 0]

    def along(x: FloatArray) -> FloatArray:
        """(B, J, k) products with the signal."""
        return np.add.reduceat(signal[..., None] * x, begin[:-1], axis=0)

    square = np.add.reduceat(signal**2, begin[:-1], axis=0)
    freed = C.image**2 / (1 + square * C.image**2)
    image = along(side)
    flat = side.reshape(-1, side.shape[2])
    parts = [slice(taxels * a, taxels * b) for a, b in pairwise(begin.tolist())]
    product = np.stack([flat[p].T @ flat[p] for p in parts])
    product -= np.swapaxes(image * freed[..., None], 1, 2) @ image
    m = np.zeros((len(lists), k))
    m[owner >= 0, :3] = at[owner[owner >= 0]]
    sessions = 0 if draws is None else draws.shape[2]
    look, square_of_look = np.zeros((len(lists), k + n, 0)), np.zeros((len(lists), 0))
    if draws is not None and rng is not None:
        own_draws = draws[order]
        errors = rng.standard_normal((len(lists), taxels, sessions)) * C.image
        own_draws += signal[..., None] * np.repeat(errors, size, axis=0)
        moved = rng.standard_normal((len(lists), k, sessions)) / np.sqrt(lam)[:, None]
        for b, (one, rows) in enumerate(zip(parts, pairwise(begin.tolist()), strict=True)):
            own_draws[slice(*rows)] += (flat[one, :k] @ moved[b]).reshape(-1, taxels, sessions)
        image_draws = along(own_draws)
        flat_draws = own_draws.reshape(-1, sessions)
        look = np.stack([flat[p, : k + n].T @ flat_draws[p] for p in parts])
        look -= np.swapaxes(image[..., : k + n] * freed[..., None], 1, 2) @ image_draws
        square_of_look = np.stack([np.einsum("rs,rs->s", flat_draws[p], flat_draws[p]) for p in parts])
        square_of_look -= np.einsum("bjs,bj->bs", image_draws**2, freed)
    g = product[:, :k, :k] + np.diag(lam)
    right = np.concatenate([product[:, :k, k:], look[:, :k]], axis=2)
    right[..., n] -= lam * m
    # In units of the diagonal: metres beside parts.
    unit = 1 / np.sqrt(np.diagonal(g, axis1=1, axis2=2))
    chol = np.linalg.cholesky(g * unit[:, :, None] * unit[:, None, :])
    z = np.linalg.solve(chol, right * unit[..., None])
    cross = np.concatenate([product[:, k : k + n, k:], look[:, k:]], axis=2)
    cross -= np.swapaxes(z[..., :n], 1, 2) @ z
    squares = np.concatenate([product[:, -1:, -1], square_of_look], axis=1)
    squares -= np.einsum("bks,bks->bs", z[..., n:], z[..., n:])
    squares[:, 0] += (m**2) @ lam
    step = np.linalg.solve(np.swapaxes(chol, 1, 2), z[..., : n + 1]) * unit[..., None]
    constant, by = np.zeros((len(at), 3)), np.zeros((len(at), 3, n))
    constant[owner[owner >= 0]], by[owner[owner >= 0]] = step[owner >= 0, :3, n], step[owner >= 0, :3, :n]
    seen, log_sd = w.seen[order], np.where(w.seen, w.log_sd, 0.0)[order]
    count = np.add.reduceat(seen.sum(axis=1), begin[:-1])
    loss = 2 * np.add.reduceat(log_sd.sum(axis=1), begin[:-1]) + np.log1p(square * C.image**2).sum(axis=1)
    loss += 2 * (np.log(np.diagonal(chol, axis1=1, axis2=2)) - np.log(unit)).sum(axis=1) - np.log(lam).sum()
    chi = squares[:, 0]
    return Blocks(
        cross[:, :, :n], cross[:, :, n], loss + chi, chi, count, owner, (constant, by), cross[:, :, n + 1 :],
        squares[:, 1:],
    )  # fmt: skip
