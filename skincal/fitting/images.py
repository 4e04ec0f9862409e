"""Simulated images from load kernels: all taxels of many contacts, with their derivatives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skincal.fitting.kernel import KernelTable, build_table, taxel_sizes
from skincal.fitting.lookup import Tables
from skincal.fitting.types import Floats, Ints
from skincal.model import Indenter, Surface, TaxelLayout

RATIO_STEP = 0.05
"""Spacing of the tabled logarithms of F/E. Linear interpolation between them is good to 3e-4 of a load share."""


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
        projected: whether taxels feel the projected pressure, see the same.
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
        projected: bool = True,
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
            projected=projected,
        )

    @property
    def lattice(self) -> tuple[float, float]:
        """Step and half the width of the planes [m]."""
        return self.table.step_m, self.table.half_m

    def tables(self) -> Tables:
        """See :meth:`skincal.fitting.seen.Images.tables`."""
        table = self.table
        none, line, whole = np.zeros((0, 2)), np.zeros(0), np.zeros(0, dtype=np.intp)
        return Tables(
            table.shares, self.size_of, self.layout.centres_m, table.half_m, _first_and_step(table.alphas_rad),
            _first_and_step(table.log_ratios), np.zeros((0, 0, 0, 0), dtype=np.float32),
            np.zeros((0, 0, 0), dtype=bool), whole.reshape(0, 0), none, line, whole, line, line, np.zeros((4, 0, 0)),
            line, np.zeros((4, 0, 0)), table.step_m,
        )  # fmt: skip

    def level(self, alpha: int, log_ratio: Floats, indenter: Ints) -> Level:
        """The kernels of K presses at the tabled turn number ``alpha`` and at log(F/E) ``log_ratio`` (K,)."""
        low, part = _bracket(log_ratio, self.table.log_ratios)
        shares = self.table.shares[:, :, alpha]
        part = part.astype(np.float32)[:, None, None, None]
        between, above = shares[indenter, :, low], shares[indenter, :, low + 1]
        between *= 1 - part
        above *= part
        between += above
        return Level(between)


def _first_and_step(knots: Floats) -> tuple[float, float]:
    return float(knots[0]), float(knots[1] - knots[0]) if len(knots) > 1 else 1.0


def _bracket(at: Floats, knots: Floats) -> tuple[Ints, Floats]:
    """Index of the knot below, and the part of the step above it."""
    step = float(knots[1] - knots[0])
    position = np.clip((at - knots[0]) / step, 0.0, len(knots) - 1.0)
    low = np.minimum(position.astype(np.intp), len(knots) - 2)
    return low, position - low
