"""Simulated images from load kernels: all taxels of many contacts, with their derivatives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skincal.fitting.kernel import KernelTable, build_table, taxel_sizes
from skincal.fitting.lookup import cubic, cubic_mixed
from skincal.fitting.problem import FitProblem
from skincal.fitting.seen import Seen, offsets, to_patch, turned_slopes
from skincal.fitting.types import Floats, Ints
from skincal.model import Indenter, Surface, TaxelLayout

RATIO_STEP = 0.05
"""Spacing of the tabled logarithms of F/E. Linear interpolation between them is good to 3e-4 of a load share."""

CHUNK = 20_000
"""Contacts evaluated at a time, to bound memory."""


@dataclass(frozen=True, eq=False)
class Shares:
    """Load shares of all taxels, and their derivatives.

    Attributes:
        value: (n, J) share of the normal force that each taxel reports.
        by_u: (n, J) derivative by the contact's u [1/m].
        by_v: (n, J) derivative by the contact's v [1/m].
        by_alpha: (n, J) derivative by the turn of the patch at fixed u, v [1/rad].
        by_log_ratio: (n, J) derivative by log(F/E).
    """

    value: Floats
    by_u: Floats
    by_v: Floats
    by_alpha: Floats
    by_log_ratio: Floats


@dataclass(frozen=True, eq=False)
class Level:
    """The kernels of K presses at one turn and one elasticity, ready for look-ups.

    Attributes:
        planes: (K * M, N, N) load shares, press by press and taxel size by taxel size.
        kinds: M, the number of taxel sizes.
    """

    planes: NDArray[np.float32]
    kinds: int


class KernelImages:
    """Images of presses with one or more indenters, for a span of turns alpha and ratios F/E.

    Args:
        surface: a cylinder or a plane.
        indenters: the different indenters of the presses.
        layout: the taxels.
        alphas_rad: (A,) equally spaced turns [rad]; between them shares are interpolated linearly (the turn acts
            mostly through u and v; what is left is the turn of a nearly round field).
        ratio_span: lowest and highest log(F/E) that will be asked for.
        step_m: lattice step of the tables [m].
        spread_m: sideways spread of the pressure [m], see :func:`skincal.fitting.kernel.build_table`.
    """

    def __init__(
        self,
        surface: Surface,
        indenters: tuple[Indenter, ...],
        layout: TaxelLayout,
        alphas_rad: Floats,
        ratio_span: tuple[float, float],
        *,
        step_m: float = 0.1e-3,
        spread_m: float = 0.0,
    ) -> None:
        count = max(2, int(np.ceil((ratio_span[1] - ratio_span[0]) / RATIO_STEP)) + 1)
        sizes, self._size_of = taxel_sizes(layout)
        self.layout = layout
        self.table: KernelTable = build_table(
            surface,
            indenters,
            sizes,
            np.asarray(alphas_rad, dtype=np.float64),
            ratio_span[0] + RATIO_STEP * np.arange(count),
            step_m=step_m,
            spread_m=spread_m,
        )

    def shares(self, uv_m: Floats, alpha_rad: Floats, log_ratio: Floats, indenter: Ints) -> Shares:
        """Load shares of contacts.

        Args:
            uv_m: (n, 2) contact positions in patch coordinates [m].
            alpha_rad: (n,) turns of the patch; beyond the tabled span the nearest is taken.
            log_ratio: (n,) log(F/E), E in [Pa/m]; beyond the tabled span the nearest is taken.
            indenter: (n,) which of the indenters.

        Returns:
            Shares of all taxels with derivatives.
        """
        out = np.zeros((5, len(uv_m), self.layout.taxels))
        for start in range(0, len(uv_m), CHUNK):
            part = slice(start, start + CHUNK)
            self._fill(out[:, part], uv_m[part], alpha_rad[part], log_ratio[part], indenter[part])
        return Shares(*out)

    def see(self, problem: FitProblem, macro: Floats, press: Ints, nuisance: Floats) -> Seen:
        """See :meth:`skincal.fitting.seen.Images.see`: only where the contact lies from the centre matters."""
        across, along, log_ratio = offsets(problem, macro, press, nuisance)
        alpha = macro[:, 2]
        uv = to_patch(across, along, alpha)
        got = self.shares(uv, alpha, log_ratio, problem.indenter[press])
        by_contact = turned_slopes(got.by_u, got.by_v, alpha)
        by_alpha = got.by_alpha + got.by_u * uv[:, 1:] - got.by_v * uv[:, :1]
        return Seen(uv, got.value, by_contact, -by_contact, by_alpha, got.by_log_ratio)

    def _fill(self, out: Floats, uv_m: Floats, alpha_rad: Floats, log_ratio: Floats, indenter: Ints) -> None:
        table = self.table
        _, kinds, alphas, levels = table.shares.shape[:4]
        planes = table.shares.reshape(-1, *table.shares.shape[4:])
        a_low, a_part, a_step = _bracket(alpha_rad, table.alphas_rad)
        r_low, r_part, r_step = _bracket(log_ratio, table.log_ratios)
        n, j, row, col = self._pairs(uv_m)
        base = ((indenter[n] * kinds + self._size_of[j]) * alphas + a_low[n]) * levels + r_low[n]
        turned = levels if alphas > 1 else 0
        wa, wr = a_part[n].astype(np.float32), r_part[n].astype(np.float32)
        share = np.stack([(1 - wa) * (1 - wr), (1 - wa) * wr, wa * (1 - wr), wa * wr])
        at, got = cubic_mixed(planes, base + np.array([[0], [1], [turned], [turned + 1]]), share, row, col)
        out[0, n, j] = got.value
        out[1, n, j] = got.by_row / table.step_m
        out[2, n, j] = got.by_col / table.step_m
        if alphas > 1:
            out[3, n, j] = ((1 - wr) * (at[2] - at[0]) + wr * (at[3] - at[1])) / a_step
        out[4, n, j] = ((1 - wa) * (at[1] - at[0]) + wa * (at[3] - at[2])) / r_step

    def level(self, alpha: int, log_ratio: Floats, indenter: Ints) -> Level:
        """The kernels of K presses at the tabled turn number ``alpha`` and at log(F/E) ``log_ratio`` (K,)."""
        low, part, _ = _bracket(log_ratio, self.table.log_ratios)
        shares = self.table.shares[:, :, alpha]
        part = part.astype(np.float32)[:, None, None, None]
        mixed = shares[indenter, :, low] * (1 - part) + shares[indenter, :, low + 1] * part
        return Level(mixed.astype(np.float32, copy=False).reshape(-1, *mixed.shape[2:]), mixed.shape[1])

    def at_level(self, level: Level, uv_m: Floats, press: Ints) -> tuple[Floats, Floats, Floats]:
        """Load shares (n, J) of contacts (n, 2) of presses (n,), with their derivatives by u and v [1/m]."""
        out = np.zeros((3, len(uv_m), self.layout.taxels), dtype=np.float32)
        n, j, row, col = self._pairs(uv_m)
        got = cubic(level.planes, press[n] * level.kinds + self._size_of[j], row, col)
        out[0, n, j] = got.value
        out[1, n, j] = got.by_row / self.table.step_m
        out[2, n, j] = got.by_col / self.table.step_m
        return out[0], out[1], out[2]

    def nearest_at_level(self, level: Level, uv_m: Floats, press: Ints) -> Floats:
        """Load shares (n, J) at the nearest nodes of the lattice: quick and rough."""
        side = level.planes.shape[1]
        out = np.zeros((len(uv_m), self.layout.taxels), dtype=np.float32)
        n, j, row, col = self._pairs(uv_m)
        plane = press[n] * level.kinds + self._size_of[j]
        at = (plane * side + np.rint(row).astype(np.intp)) * side + np.rint(col).astype(np.intp)
        out[n, j] = level.planes.reshape(-1)[at]
        return out

    def _pairs(self, uv_m: Floats) -> tuple[Ints, Ints, NDArray[np.float32], NDArray[np.float32]]:
        """Contacts and taxels that can have to do with each other, and where on the lattice."""
        centres, half = self.layout.centres_m.astype(np.float32), np.float32(self.table.half_m)
        step, reach = np.float32(self.table.step_m), np.float32(self.table.half_m - 1.5 * self.table.step_m)
        along_u = uv_m[:, :1].astype(np.float32) - centres[:, 0]
        along_v = uv_m[:, 1:].astype(np.float32) - centres[:, 1]
        pair = np.flatnonzero((np.abs(along_u) < reach) & (np.abs(along_v) < reach))
        n, j = np.divmod(pair, len(centres))
        return n, j, (along_u.reshape(-1)[pair] + half) / step, (along_v.reshape(-1)[pair] + half) / step


def _bracket(at: Floats, knots: Floats) -> tuple[Ints, Floats, float]:
    """Index of the knot below, the part of the step above it, and the step."""
    if len(knots) == 1:
        return np.zeros(len(at), dtype=np.intp), np.zeros(len(at)), 1.0
    step = float(knots[1] - knots[0])
    position = np.clip((at - knots[0]) / step, 0.0, len(knots) - 1.0)
    low = np.minimum(position.astype(np.intp), len(knots) - 2)
    return low, position - low, step
