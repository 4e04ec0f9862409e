"""Whitened normal equations of each press, with the nuisance parameters of the press integrated out.

For a press p with whitened columns C, residual e and nuisance columns N of prior precision L (shift of the contact,
scale of the force, image error, equation error of each effect in the model), let G = N'N + L::

    H_p = C'C - C'N G^-1 N'C,   b_p = C'e - C'N G^-1 (N'e - L m),   chi_p = e'e + m'Lm - v'G^-1 v,  v = N'e - L m

with m the present nuisance parameters. Fits, scores and null sessions are linear algebra on H_p and b_p.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from skincal.fitting.lookup import allocating
from skincal.inference.constants import CONSTANTS as C
from skincal.inference.slopes import Slopes
from skincal.model.arrays import BoolArray, FloatArray, IntArray, as_floats

IDLE_BLOCKS = 12


@dataclass(frozen=True, eq=False)
class Blocks:
    """Normal equations of B blocks: presses, then stretches of rest.

    Attributes:
        b: (B, n) slopes.
        loss: (B,) minus twice the log-likelihood, up to a constant, with presses where they are.
        ahead: (B,) linear estimate of how much less the loss is at the best nuisance parameters of the press.
        chi: (B,) squared residuals over the noise.
        count: (B,) number of values.
        press: (B,) row of the press, -1 for rest.
        moves: (P, 3, n) minus the change of each press's best shift and force with a step of each column.
        own: curvature (B, k, k) and slope (B, k) of the nuisance parameters, shift and force last.
        drawn: (B, n, S) ``b`` of simulated sessions.
        drawn_chi: (B, S) ``chi`` of simulated sessions.
        products: of the columns, from which ``H_p`` is computed on demand.
    """

    b: FloatArray
    loss: FloatArray
    ahead: FloatArray
    chi: FloatArray
    count: IntArray
    press: IntArray
    moves: FloatArray
    own: tuple[FloatArray, FloatArray]
    drawn: FloatArray
    drawn_chi: FloatArray
    products: Products

    @cached_property
    def h(self) -> FloatArray:
        """Curvatures (B, n, n); with many columns, use :meth:`Products.between` for parts."""
        every = np.arange(self.b.shape[1])
        return self.products.between(every, every)


@dataclass(frozen=True, eq=False)
class Products:
    """Products of n columns in B blocks, image errors integrated out; columns of different taxels are orthogonal.

    Attributes:
        taxel: (n,) taxel of a single-taxel column, -1 for a dense one.
        place: (n,) index of a column among the dense ones, or among those of its taxel.
        dense: (B, d, d) products of dense columns.
        mixed: (B, J, d, m) products of dense columns with those of each taxel.
        single: (B, J, m, m) products of the columns of each taxel.
        z: (B, k, n) columns projected on the nuisance columns; the product of two is subtracted.
    """

    taxel: IntArray
    place: IntArray
    dense: FloatArray
    mixed: FloatArray
    single: FloatArray
    z: FloatArray

    def between(self, rows: IntArray, columns: IntArray) -> FloatArray:
        """Return the block (B, r, c) of ``H_p``."""
        out = np.zeros((len(self.z), len(rows), len(columns)))
        (d, s), (e, t) = (
            (np.flatnonzero(self.taxel[x] < 0), np.flatnonzero(self.taxel[x] >= 0)) for x in (rows, columns)
        )
        place, taxel = self.place, self.taxel
        out[:, d[:, None], e] = self.dense[:, place[rows[d]][:, None], place[columns[e]]]
        own, other = rows[s], columns[t]
        out[:, d[:, None], t] = self.mixed[:, taxel[other], place[rows[d]][:, None], place[other]]
        out[:, s[:, None], e] = self.mixed[:, taxel[own][:, None], place[columns[e]], place[own][:, None]]
        i, k = np.nonzero(taxel[own][:, None] == taxel[other])
        out[:, s[i], t[k]] = self.single[:, taxel[own[i]], place[own[i]], place[other[k]]]
        out -= np.swapaxes(self.z[:, :, rows], 1, 2) @ self.z[:, :, columns]
        return out

    @cached_property
    def whole(self) -> Products:
        """Sum over all blocks, as one block."""
        dense, mixed, single = (x.sum(axis=0)[None] for x in (self.dense, self.mixed, self.single))
        return Products(self.taxel, self.place, dense, mixed, single, self.z.reshape(1, -1, self.z.shape[2]))


@dataclass(frozen=True, eq=False)
class Rows:
    """Order of the observations: M with any reading, those of presses first, then those at rest.

    Attributes:
        order: (M,) indices of observations.
        begin: (B + 1,) first of each block, and the end.
        owner: (B,) row of the press, -1 for rest.
        pressed: number of observations of presses.
        phases: masks (N,), one for each phase of a press.
    """

    order: IntArray
    begin: IntArray
    owner: IntArray
    pressed: int
    phases: tuple[BoolArray, ...]

    @classmethod
    def of(cls, press: IntArray, phase: IntArray, seen: BoolArray) -> Rows:
        """Sort observations by press (N,), -1 at rest; those without a reading (N, J) in any taxel are left out."""
        rows = [np.flatnonzero(press == p) for p in range(int(press.max(initial=-1)) + 1)]
        rows += np.array_split(np.flatnonzero(press < 0), IDLE_BLOCKS)
        rows = [r for r in rows if seen[r].any()]
        owner = np.array([int(press[r[0]]) for r in rows])
        begin = np.concatenate([[0], np.cumsum([len(r) for r in rows])])
        phases = tuple(phase == f for f in np.unique(phase[press >= 0]))
        return cls(np.concatenate(rows), begin, owner, int(begin[(owner >= 0).sum()]), phases)


@dataclass(frozen=True, eq=False)
class Whitened:
    """A linearisation of N observations of J taxels, divided by the noise and with robust weights.

    Attributes:
        residual: (N, J).
        columns: slopes by n parameters.
        press: (N, J, 3) slopes by the shift of the press across and along and by the logarithm of its force.
        signal: (N, J) expected level above rest.
        own: (N, J, k) equation error of each effect in the model, one standard deviation.
        seen: (N, J) True where there is a reading.
        log_sd: (N, J) logarithm of the noise.
    """

    residual: FloatArray
    columns: Slopes
    press: FloatArray
    signal: FloatArray
    own: FloatArray
    seen: BoolArray
    log_sd: FloatArray


def blocks(
    w: Whitened,
    rows: Rows,
    at: FloatArray,
    precision: FloatArray,
    draws: FloatArray | None = None,
    rng: np.random.Generator | None = None,
    image: float = C.image,
) -> Blocks:
    """Integrate out the nuisance parameters of each press.

    The image error is one parameter for each taxel and press, along the signal s. It is integrated out first:
    ``x'y - (s'x) (s'y) / (l + s's)`` replaces every product x'y over the observations of a taxel.

    Args:
        w: whitened linearisation.
        rows: order of the observations.
        at: (P, 3) present shift and log force scale of each press.
        precision: (3,) their prior precisions.
        draws: (N, J, S) whitened residuals of S simulated sessions; nuisance parameters are drawn and added here.
        rng: for those.
        image: relative error of the image of a press, independent in each taxel.
    """
    taxels, n, dense = w.residual.shape[1], len(w.columns), w.columns.dense.shape[2]
    order, begin, owner = rows.order, rows.begin, rows.owner
    errs = [w.own * f[:, None, None] for f in rows.phases] if w.own.shape[2] else []
    # Shift and force come last, so that their part is separate in the Cholesky factor.
    lam = np.append(np.ones(len(errs) * w.own.shape[2]), precision)
    k = len(lam)
    # Nuisance columns, dense columns and residual side by side; only their products by block are needed.
    side = np.concatenate([*errs, w.press, w.columns.dense, w.residual[..., None]], axis=2)[order]
    own, slot = w.columns.slots()
    own, of_one = own[order], w.columns.taxel >= 0
    signal = w.signal[order]
    # Blocks at rest have no nuisance parameters.
    side[rows.pressed :, :, :k], signal[rows.pressed :] = 0.0, 0.0
    square = np.add.reduceat(signal**2, begin[:-1], axis=0)
    freed = image**2 / (1 + square * image**2)
    by_image, own_image = _along(signal, side, begin), _along(signal, own, begin)
    flat = side.reshape(-1, side.shape[2])
    spans = list(pairwise(begin.tolist()))
    parts = [slice(taxels * a, taxels * b) for a, b in spans]
    product = np.stack([flat[p].T @ flat[p] for p in parts])
    product -= np.swapaxes(by_image * freed[..., None], 1, 2) @ by_image
    mixed, single = _of_taxels(side, own, spans)
    mixed -= by_image[..., None] * (freed[..., None] * own_image)[:, :, None]
    single -= own_image[..., None] * (freed[..., None] * own_image)[:, :, None]
    m = np.zeros((len(owner), k))
    m[owner >= 0, -3:] = at[owner[owner >= 0]]

    def arranged(dense: FloatArray, single: FloatArray) -> FloatArray:
        """Put products of dense (B, d, q) and single-taxel columns (B, J, m, q) in column order: (B, n, q)."""
        out = np.empty((len(dense), n, dense.shape[2]))
        out[:, ~of_one], out[:, of_one] = dense, single[:, w.columns.own, slot]
        return out

    sessions = 0 if draws is None else draws.shape[2]
    drawn_own = np.zeros((len(owner), k, sessions))
    drawn, drawn_chi = np.zeros((len(owner), n, sessions)), np.zeros((len(owner), sessions))
    if draws is not None and rng is not None:
        errors = rng.standard_normal((len(owner), taxels, sessions)) * image
        moved = rng.standard_normal((len(owner), k, sessions)) / np.sqrt(lam)[:, None]
        for b, (one, span) in enumerate(zip(parts, spans, strict=True)):
            mine = slice(*span)
            each = draws[order[mine]] + signal[mine, :, None] * errors[b]
            each += (flat[one, :k] @ moved[b]).reshape(-1, taxels, sessions)
            along_it = np.einsum("rj,rjs->js", signal[mine], each)
            taken = freed[b][:, None] * along_it
            looked = (
                flat[one, : k + dense].T @ each.reshape(-1, sessions) - by_image[b, :, : k + dense].T @ taken
            )
            of_one_looked = own[mine].transpose(1, 2, 0) @ each.transpose(1, 0, 2)
            of_one_looked -= own_image[b][..., None] * taken[:, None]
            drawn_own[b], drawn[b] = looked[:k], arranged(looked[None, k:], of_one_looked[None])[0]
            drawn_chi[b] = np.einsum("rjs,rjs->s", each, each) - (along_it * taken).sum(axis=0)
    # Products of nuisance columns with the columns, the residual and simulated sessions.
    by_own = np.swapaxes(arranged(product[:, k : k + dense, :k], mixed[:, :, :k].swapaxes(2, 3)), 1, 2)
    by_residual = arranged(product[:, k : k + dense, -1:], mixed[:, :, -1, :, None])
    right = np.concatenate([by_own, product[:, :k, -1:], drawn_own], axis=2)
    right[..., n] -= lam * m
    g = product[:, :k, :k] + np.diag(lam)
    # In units of the diagonal: columns are in metres and logarithms.
    unit = 1 / np.sqrt(np.diagonal(g, axis1=1, axis2=2))
    chol = np.linalg.cholesky(g * unit[:, :, None] * unit[:, None, :])
    z = np.linalg.solve(chol, right * unit[..., None])
    of_columns = as_floats(np.ascontiguousarray(z[..., :n]))
    gone = np.swapaxes(of_columns, 1, 2) @ z[..., n:]
    squares = np.concatenate([product[:, -1:, -1], drawn_chi], axis=1)
    squares -= np.einsum("bks,bks->bs", z[..., n:], z[..., n:])
    squares[:, 0] += (m**2) @ lam
    step = np.linalg.solve(np.swapaxes(chol, 1, 2), of_columns) * unit[..., None]
    by = np.zeros((len(at), 3, n))
    by[owner[owner >= 0]] = step[owner >= 0, -3:]
    seen, log_sd = w.seen[order], np.where(w.seen, w.log_sd, 0.0)[order]
    count = np.add.reduceat(seen.sum(axis=1), begin[:-1])
    loss = 2 * np.add.reduceat(log_sd.sum(axis=1), begin[:-1]) + np.log1p(square * image**2).sum(axis=1)
    loss += 2 * (np.log(np.diagonal(chol, axis1=1, axis2=2)) - np.log(unit)).sum(axis=1) - np.log(lam).sum()
    chi, ahead = squares[:, 0], (z[:, -3:, n] ** 2).sum(axis=1)
    place = np.empty(n, dtype=np.int64)
    place[~of_one], place[of_one] = np.arange(dense), slot
    products = Products(
        w.columns.taxel,
        place,
        product[:, k : k + dense, k : k + dense],
        mixed[:, :, k : k + dense],
        single,
        of_columns,
    )
    return Blocks(
        by_residual[..., 0] - gone[..., 0], loss + chi + ahead, ahead, chi, count, owner, by,
        (g, right[..., n]), drawn - gone[..., 1:], squares[:, 1:], products,
    )  # fmt: skip


@allocating
def _along(signal, x, begin):
    """Compute products (B, J, k) of the signal (M, J) with columns (M, J, k), block by block."""
    out = np.zeros((len(begin) - 1, x.shape[1], x.shape[2]))
    for b in range(len(out)):
        for r in range(begin[b], begin[b + 1]):
            for j in range(x.shape[1]):
                if signal[r, j] != 0.0:
                    for k in range(x.shape[2]):
                        out[b, j, k] += signal[r, j] * x[r, j, k]
    return out


def _of_taxels(
    side: FloatArray, own: FloatArray, spans: Sequence[tuple[int, int]]
) -> tuple[FloatArray, FloatArray]:
    """Multiply single-taxel columns (N, J, m) with others (N, J, q) and with each other, in each block."""
    (taxels, m), q = own.shape[1:], side.shape[2]
    mixed, single = np.zeros((len(spans), taxels, q, m)), np.zeros((len(spans), taxels, m, m))
    if m:
        by_taxel, columns = side.transpose(1, 2, 0), own.transpose(1, 0, 2)
        for b, (first, end) in enumerate(spans):
            part = np.ascontiguousarray(columns[:, first:end])
            mixed[b] = by_taxel[:, :, first:end] @ part
            single[b] = part.swapaxes(1, 2) @ part
    return mixed, single
