"""Simulated images from load kernels: all taxels of many contacts, with their derivatives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skincal.fitting.kernel import KernelTable, build_table, taxel_sizes
from skincal.fitting.lookup import mixed
from skincal.fitting.problem import FitProblem
from skincal.fitting.seen import Seen, offsets, to_patch, turned_slopes
from skincal.fitting.types import Floats, Ints
from skincal.model import Indenter, Surface, TaxelLayout

RATIO_STEP = 0.05
"""Spacing of the tabled logarithms of F/E. Linear interpolation between them is good to 3e-4 of a load share."""


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
        planes: (K, M, N, N) load shares, press by press and taxel size by taxel size.
    """

    planes: NDArray[np.float32]


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
        sizes, self.size_of = taxel_sizes(layout)
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

    @property
    def lattice(self) -> tuple[float, float]:
        """Step and half the width of the planes [m]."""
        return self.table.step_m, self.table.half_m

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
        table = self.table
        out = np.zeros((5, len(uv_m), self.layout.taxels))
        turn, ratio = _bracket(alpha_rad, table.alphas_rad), _bracket(log_ratio, table.log_ratios)
        mixed(
            table.shares, self.size_of, self.layout.centres_m, self.lattice, uv_m, indenter, turn, ratio, out
        )
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

    def level(self, alpha: int, log_ratio: Floats, indenter: Ints) -> Level:
        """The kernels of K presses at the tabled turn number ``alpha`` and at log(F/E) ``log_ratio`` (K,)."""
        low, part, _ = _bracket(log_ratio, self.table.log_ratios)
        shares = self.table.shares[:, :, alpha]
        part = part.astype(np.float32)[:, None, None, None]
        between = shares[indenter, :, low] * (1 - part) + shares[indenter, :, low + 1] * part
        return Level(between.astype(np.float32, copy=False))


def _bracket(at: Floats, knots: Floats) -> tuple[Ints, Floats, float]:
    """Index of the knot below, the part of the step above it, and the step."""
    if len(knots) == 1:
        return np.zeros(len(at), dtype=np.intp), np.zeros(len(at)), 1.0
    step = float(knots[1] - knots[0])
    position = np.clip((at - knots[0]) / step, 0.0, len(knots) - 1.0)
    low = np.minimum(position.astype(np.intp), len(knots) - 2)
    return low, position - low, step
