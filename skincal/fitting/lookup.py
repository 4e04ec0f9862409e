"""Compiled cubic look-ups in tables, with derivatives: the cubic convolution of Keys (1981, a = -1/2).

It is exact for quadratics and has a continuous slope. Tables are in single precision; sums are in double
precision.
"""

from __future__ import annotations

import hashlib
import inspect
import sys
from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar, cast

import numba
import numpy as np
from numpy.typing import NDArray

from skincal.fitting.types import Bools, Floats, Ints
from skincal.model.press.jit import cached

_Function = TypeVar("_Function", bound=Callable[..., Any])
_SETTINGS: dict[str, Any] = {
    "nogil": True,
    "no_cfunc_wrapper": True,
    "error_model": "numpy",
    "fastmath": {"reassoc", "contract", "nsz", "arcp"},
    "_nrt": False,
}
"""Numba settings. Without numba's runtime, functions cannot allocate, and do not count references to arrays,
which would take as long as the rest of a look-up."""
_INLINED: dict[str, Any] = {"forceinline": True, "no_cpython_wrapper": True, **_SETTINGS}
"""Numba settings of functions that are inlined into compiled callers."""
_STAMP = hashlib.sha256(inspect.getsource(sys.modules[__name__]).encode()).hexdigest()[:16]
"""Digest of this module, whose functions are inlined into those of others: part of the key of the compilation cache."""


def compiled(function: _Function) -> _Function:
    """Compile a function of the fit; the compilation is cached on disk for later processes."""
    return cast(_Function, cached(function, f"{function.__name__}_{_STAMP}", _SETTINGS))


def allocating(function: _Function) -> _Function:
    """Compile as :func:`compiled` does, for a function that allocates arrays."""
    return cast(_Function, cached(function, f"{function.__name__}_{_STAMP}", {**_SETTINGS, "_nrt": True}))


def inlined(function: _Function) -> _Function:
    """Compile a function for inlining into compiled callers only; Python cannot call it."""
    return cast(_Function, numba.njit(**_INLINED)(function))


@inlined
def cubic_taps(at: float, side: int) -> Any:  # pragma: no cover - compiled
    """Return the first of the four nodes around a position, their weights, and the derivatives of the weights."""
    at = min(max(at, 1.0), side - 2.001)
    low = int(at)
    t = at - low
    weight = (
        ((-0.5 * t + 1.0) * t - 0.5) * t,
        (1.5 * t - 2.5) * t * t + 1.0,
        ((-1.5 * t + 2.0) * t + 0.5) * t,
        (0.5 * t - 0.5) * t * t,
    )
    slope = ((-1.5 * t + 2.0) * t - 0.5, (4.5 * t - 5.0) * t, (-4.5 * t + 4.0) * t + 0.5, (1.5 * t - 1.0) * t)
    return low - 1, weight, slope


@inlined
def interpolate_plane(plane: Any, rows: Any, cols: Any) -> Any:  # pragma: no cover - compiled
    """Return the value of a plane (N, N) and its derivatives along both axes, for the taps of a row and a column."""
    r0, rw, rs = rows
    c0, cw, cs = cols
    value = by_row = by_col = 0.0
    for r in range(4):
        along = slope = 0.0
        for c in range(4):
            tap = plane[r0 + r, c0 + c]
            along += tap * cw[c]
            slope += tap * cs[c]
        value += rw[r] * along
        by_row += rs[r] * along
        by_col += rw[r] * slope
    return value, by_row, by_col


@allocating
def look_up_cubic(planes: Any, plane: Any, row: Any, col: Any) -> Any:  # pragma: no cover - compiled
    """Return values (3, n) in planes (P, N, N), and their derivatives along both axes per lattice step.

    ``plane`` (n,) is the number of the plane, ``row`` and ``col`` (n,) are positions in lattice steps, which are
    clamped to the plane.
    """
    out = np.empty((3, len(plane)))
    side = planes.shape[1]
    for i in range(len(plane)):
        rows, cols = cubic_taps(row[i], side), cubic_taps(col[i], side)
        out[0, i], out[1, i], out[2, i] = interpolate_plane(planes[plane[i]], rows, cols)
    return out


@inlined
def look_up_level(
    planes: Any, size_of: Any, centres: Any, lattice: Any, u: float, v: float, press: int, near: Any, out: Any
) -> int:  # pragma: no cover - compiled
    """Fill ``out`` (3, J) with the load shares of taxels under one contact, and their slopes by u and v [1/m].

    ``planes`` and ``lattice`` are those of :meth:`KernelTable.level`, ``size_of`` and ``centres`` those of the
    table. ``near`` (J,) is filled with the numbers of the taxels that the contact may reach; their count is
    returned.
    """
    step, half, reaches = lattice
    reach, side, count = reaches[press], planes.shape[2], 0
    for j in range(len(centres)):
        du, dv = u - centres[j, 0], v - centres[j, 1]
        if abs(du) < reach and abs(dv) < reach:
            value, by_row, by_col = interpolate_plane(
                planes[press, size_of[j]],
                cubic_taps((du + half) / step, side),
                cubic_taps((dv + half) / step, side),
            )
            out[0, j], out[1, j], out[2, j] = value, by_row / step, by_col / step
            near[count] = j
            count += 1
        else:
            out[0, j] = out[1, j] = out[2, j] = 0.0
    return count


class KernelTable(NamedTuple):
    """Load shares phi of every indenter and taxel size, for several turns alpha and ratios F/E.

    Attributes:
        shares: (I, M, A, L, N, N) float32: for indenter i, taxel size m, turn a and ratio l, the share of the
            normal force at offsets (u, v) of the contact from the taxel's centre; zero on the two outer
            nodes.
        size_of: (J,) number of the size of each taxel.
        centres_m: (J, 2) of the taxels [m].
        turns: first tabled turn and the step [rad].
        ratios: first tabled log(F_n / E) and the step; F_n / E in [m³].
        step_m: lattice step [m].
        half_m: offset of the outermost nodes [m].
        reach_m: (I, L) offset along u or v from which look-ups are zero, at a ratio and the next [m].
    """

    shares: NDArray[np.float32]
    size_of: Ints
    centres_m: Floats
    turns: tuple[float, float]
    ratios: tuple[float, float]
    step_m: float
    half_m: float
    reach_m: Floats

    def level(
        self, turn: int, log_ratio: Floats, indenter: Ints
    ) -> tuple[NDArray[np.float32], tuple[float, float, Floats]]:
        """Return the load shares of presses (K,) at a tabled turn and log(F/E), cropped to where they are not zero.

        Returns:
            (K, M, N, N) load shares, and their lattice: step, half width, and reach as in ``reach_m`` (K,) [m].
        """
        levels, (first, step) = self.shares.shape[3], self.ratios
        position = np.clip((log_ratio - first) / step, 0.0, levels - 1.0)
        low = np.minimum(position.astype(np.intp), levels - 2)
        part = (position - low).astype(np.float32)[:, None, None, None]
        reach = self.reach_m[indenter, low]
        edge = int(self.half_m / self.step_m - float(reach.max()) / self.step_m - 1.5 + 1e-6)
        inner = slice(edge, self.shares.shape[-1] - edge)
        shares = self.shares[:, :, turn, :, inner, inner]
        between, above = shares[indenter, :, low], shares[indenter, :, low + 1]
        between *= 1 - part
        above *= part
        between += above
        return between, (self.step_m, self.half_m - edge * self.step_m, reach)


class ImageTable(NamedTuple):
    """Images tabled press by press: the arrays of :class:`skincal.fitting.general_table.SkinTable`, and splines.

    ``turn_spline`` (4, 2, 3) and ``level_spline`` (4, L - 1, L) are coefficients of the splines that are 1 at one
    knot of the turn, or of log(F/E), and 0 at the others; knots are relative to the middle one.
    """

    shares: NDArray[np.float32]
    lit: Bools
    plane: Ints
    anchor_m: Floats
    middle: Floats
    slot: Ints
    centre: Floats
    turn_knots: Floats
    turn_spline: Floats
    level_knots: Floats
    level_spline: Floats
    step_m: float


class Tables(NamedTuple):
    """Tables of load shares: images press by press if there are any, else kernels."""

    kernels: KernelTable
    images: ImageTable


_NONE, _PAIRS, _WHOLE, _CUBICS = np.zeros(0), np.zeros((0, 2)), np.zeros(0, np.intp), np.zeros((4, 0, 0))

NO_KERNELS = KernelTable(
    np.zeros((0, 0, 0, 0, 0, 0), np.float32), _WHOLE, _PAIRS, (0.0, 1.0), (0.0, 1.0), 1.0, 0.0, _PAIRS
)
"""Empty kernel tables, for fits with image tables."""
NO_IMAGES = ImageTable(
    np.zeros((0, 0, 0, 0), np.float32), np.zeros((0, 0, 0), np.bool_), _WHOLE.reshape(0, 0), _PAIRS, _NONE, _WHOLE,
    _NONE, _NONE, _CUBICS, _NONE, _CUBICS, 1.0,
)  # fmt: skip
"""Empty image tables, for fits with kernel tables."""


@inlined
def _find_knot(at: float, first: float, step: float, count: int) -> Any:  # pragma: no cover - compiled
    """Return the number of the knot below a position, and the fraction of the step above it."""
    position = min(max((at - first) / step, 0.0), count - 1.0)
    low = min(int(position), max(count - 2, 0))
    return low, position - low


@inlined
def _look_up_kernels(
    tables: Any, kind: int, u: float, v: float, alpha: float, log_ratio: float, near: Any, out: Any
) -> int:  # pragma: no cover - compiled
    """Look up kernels, linearly between turns and between ratios; see :func:`look_up`."""
    shares, step = tables.shares, tables.step_m
    a, wa = _find_knot(alpha, tables.turns[0], tables.turns[1], shares.shape[2])
    r, wr = _find_knot(log_ratio, tables.ratios[0], tables.ratios[1], shares.shape[3])
    reach, side = tables.reach_m[kind, r], shares.shape[4]
    # Corners of the interpolation: the turn below and above, the ratio below and above; there may be one turn.
    corners, count = 4 if shares.shape[2] > 1 else 2, 0
    for j in range(len(tables.centres_m)):
        du, dv = u - tables.centres_m[j, 0], v - tables.centres_m[j, 1]
        if not (abs(du) < reach and abs(dv) < reach):
            continue
        near[count] = j
        count += 1
        rows, cols = (
            cubic_taps((du + tables.half_m) / step, side),
            cubic_taps((dv + tables.half_m) / step, side),
        )
        share = by_u = by_v = by_turn = by_ratio = 0.0
        for corner in range(corners):
            over, above = corner // 2, corner % 2
            plane = shares[kind, tables.size_of[j], a + over, r + above]
            value, by_row, by_col = interpolate_plane(plane, rows, cols)
            turn, ratio = wa if over else 1.0 - wa, wr if above else 1.0 - wr
            share += turn * ratio * value
            by_u += turn * ratio * by_row
            by_v += turn * ratio * by_col
            by_ratio += (turn if above else -turn) * value
            by_turn += (ratio if over else -ratio) * value
        out[0, j], out[1, j], out[2, j] = share, by_u / step, by_v / step
        out[3, j] = by_turn / tables.turns[1] if corners > 2 else 0.0
        out[4, j] = by_ratio / tables.ratios[1]
        out[5, j] = out[6, j] = 0.0
    return count


@inlined
def _evaluate_splines(knots: Any, spline: Any, at: float, out: Any) -> None:  # pragma: no cover - compiled
    """Fill ``out`` (2, L) with the splines of all knots, and their slopes, at a position clamped to the knots."""
    last = len(knots) - 1
    at = min(max(at, knots[0]), knots[last])
    piece = min(int((at - knots[0]) / (knots[last] - knots[0]) * last), last - 1)
    t = at - knots[piece]
    for k in range(len(knots)):
        a, b, c, d = spline[0, piece, k], spline[1, piece, k], spline[2, piece, k], spline[3, piece, k]
        out[0, k] = ((a * t + b) * t + c) * t + d
        out[1, k] = (3.0 * a * t + 2.0 * b) * t + c


@inlined
def _look_up_images(
    tables: Any,
    row: int,
    macro: Any,
    u: float,
    v: float,
    log_ratio: float,
    workspace: Any,
    near: Any,
    out: Any,
) -> int:  # pragma: no cover - compiled
    """Look up images, by splines of turns and ratios and the slopes by the centre; see :func:`look_up`."""
    shares, step = tables.shares, tables.step_m
    weights, sums, spots, turn, level = workspace
    slot = tables.slot[row]
    side, channels = shares.shape[1], shares.shape[3]
    _evaluate_splines(tables.turn_knots, tables.turn_spline, macro[2] - tables.centre[2], turn)
    _evaluate_splines(tables.level_knots, tables.level_spline, log_ratio - tables.middle[slot], level)
    levels = len(tables.level_knots)
    for c in range(channels - 2):
        a, b = c // levels, c % levels
        weights[0, c] = turn[0, a] * level[0, b]
        weights[1, c] = turn[1, a] * level[0, b]
        weights[2, c] = turn[0, a] * level[1, b]
    for d in range(2):
        c = channels - 2 + d
        weights[0, c], weights[1, c], weights[2, c] = macro[d] - tables.centre[d], 0.0, 0.0
    at_row = (u - tables.anchor_m[slot, 0]) / step + (side - 1) / 2
    at_col = (v - tables.anchor_m[slot, 1]) / step + (side - 1) / 2
    near_row = int(min(max(at_row, 0.0), side - 1.0) + 0.5)
    near_col = int(min(max(at_col, 0.0), side - 1.0) + 0.5)
    r0, rw, rs = cubic_taps(at_row, side)
    c0, cw, cs = cubic_taps(at_col, side)
    for r in range(4):
        for q in range(4):
            spots[0, 4 * r + q] = rw[r] * cw[q]
            spots[1, 4 * r + q] = rs[r] * cw[q] / step
            spots[2, 4 * r + q] = rw[r] * cs[q] / step
    count = 0
    for j in range(tables.plane.shape[1]):
        p = tables.plane[slot, j]
        if p < 0 or not tables.lit[p, near_row, near_col]:
            continue
        near[count] = j
        count += 1
        for c in range(channels):
            sums[0, c] = sums[1, c] = sums[2, c] = 0.0
        for tap in range(16):
            values = shares[p, r0 + tap // 4, c0 + tap % 4]
            for c in range(channels):
                sums[0, c] += spots[0, tap] * values[c]
                sums[1, c] += spots[1, tap] * values[c]
                sums[2, c] += spots[2, tap] * values[c]
        for i in range(5):
            out[i, j] = 0.0
        for c in range(channels):
            out[0, j] += weights[0, c] * sums[0, c]
            out[1, j] += weights[0, c] * sums[1, c]
            out[2, j] += weights[0, c] * sums[2, c]
            out[3, j] += weights[1, c] * sums[0, c]
            out[4, j] += weights[2, c] * sums[0, c]
        out[5, j], out[6, j] = sums[0, channels - 2], sums[0, channels - 1]
    return count


@inlined
def look_up(
    tables: Any,
    kind: int,
    row: int,
    macro: Any,
    u: float,
    v: float,
    log_ratio: float,
    workspace: Any,
    near: Any,
    out: Any,
) -> int:  # pragma: no cover - compiled
    """Fill ``out`` (7, J) with load shares and their slopes by u, v, turn, log(F/E), and the centre's position.

    ``kind`` is the number of the indenter, ``row`` that of the press in its session, ``workspace`` from
    :func:`allocate_lookup`. ``near`` (J,) is filled with the numbers of the taxels that the contact may reach,
    ``out`` for these only; their count is returned.
    """
    if tables.images.shares.shape[0] > 0:
        return _look_up_images(tables.images, row, macro, u, v, log_ratio, workspace, near, out)
    return _look_up_kernels(tables.kernels, kind, u, v, macro[2], log_ratio, near, out)


def allocate_lookup(tables: Tables) -> tuple[Floats, ...]:
    """Return the arrays that :func:`look_up` works in."""
    images = tables.images
    channels = images.shares.shape[3]
    turn, level = np.empty((2, len(images.turn_knots))), np.empty((2, len(images.level_knots)))
    return np.empty((3, channels)), np.empty((3, channels)), np.empty((3, 16)), turn, level
