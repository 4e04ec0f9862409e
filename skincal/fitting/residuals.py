"""Residuals of presses and the search for their nuisance, compiled: see :mod:`skincal.fitting.presses`."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from skincal.fitting.lookup import compiled, inlined, look_up, room_for
from skincal.fitting.types import Floats, Ints

_DESCENTS = 6
"""Levenberg's steps at most."""
_BLUNT_FROM = 6
"""Gauss-Newton's steps from this one on are damped a little."""
_AT_REST = 2e-4
"""Part of the largest step below which a press is at rest."""


class Presses(NamedTuple):
    """Data of K presses and of the J taxels, for the compiled search.

    Attributes:
        at: (K, 6) measured position across and along [m], logarithm of the force [N], and the slack [m] and force error
            about which the press's own are scattered.
        which: (K, 2) indenter, and number in the session.
        readings: (5, K, J) target, share and signal of :class:`skincal.fitting.readings.Readings`; 1 where a reading
            counts; 1 where it is at the converter's upper bound.
        taxels: (2, J) gain, and level above the converter's lower bound [counts].
        link: (3, N) values, mean and slope of the converter's link.
    """

    at: Floats
    which: Ints
    readings: Floats
    taxels: Floats
    link: Floats

    def scattered_about(self, press: Ints, centre_m: Floats) -> Presses:
        """Presses (n,), some more than once, each with a slack (n, 2) [m] of its own about which it is scattered."""
        at = self.at[press]
        at[:, 3:5] = centre_m
        readings = np.ascontiguousarray(self.readings[:, press])
        return Presses(at, self.which[press], readings, self.taxels, self.link)


class Found(NamedTuple):
    """Arrays to be filled for n pairs of a macro draw and a press: see :class:`skincal.fitting.presses.PressStates`."""

    nuisance: Floats
    objective: Floats
    hessian: Floats
    uv: Floats
    residual: Floats
    simulated: Floats
    macro_slope: Floats
    nuisance_slope: Floats
    level_slope: Floats


@inlined
def expected(above: float, link: Any) -> Any:  # pragma: no cover - compiled
    """Mean count and slope for a value above the converter's bound: :class:`skincal.fitting.readings.Link`."""
    values, mean, slope = link[0], link[1], link[2]
    if len(values) == 0:
        return above, 1.0
    step = values[1] - values[0]
    at = min(max((above - values[0]) / step, 0.0), len(values) - 1.001)
    low = int(at)
    part = at - low
    lift, next_lift = mean[low] - values[low], mean[low + 1] - values[low + 1]
    return above + lift + part * (next_lift - lift), slope[low] + part * (slope[low + 1] - slope[low])


@inlined
def _evaluate(
    tables: Any,
    presses: Any,
    macro: Any,
    sigmas: Any,
    k: int,
    x: Any,
    room: Any,
    seen: Any,
    i: int,
    found: Any,
    g: Any,
) -> None:  # pragma: no cover - compiled
    """Fill row ``i`` of ``found`` for press ``k`` at nuisance ``x`` (3,), and half the gradient ``g`` (3,) of Q."""
    cos, sin = math.cos(macro[2]), math.sin(macro[2])
    at, readings = presses.at[k], presses.readings
    across, along = at[0] + x[0] - macro[0], at[1] + x[1] - macro[1]
    u, v = across * cos + along * sin, along * cos - across * sin
    log_ratio = at[2] + x[2] - macro[3]
    look_up(tables, presses.which[k, 0], presses.which[k, 1], macro, u, v, log_ratio, room, seen)
    scale = math.exp(macro[4] + x[2] + at[2])
    hessian, total = found.hessian[i], 0.0
    for a in range(3):
        found.nuisance[i, a] = x[a]
        g[a] = 0.0
        for b in range(3):
            hessian[a, b] = 0.0
    found.uv[i, 0], found.uv[i, 1] = u, v
    for j in range(presses.taxels.shape[1]):
        counts = scale * presses.taxels[0, j]
        load = counts * seen[0, j]
        found.simulated[i, j] = load
        mean, rate = expected(load + presses.taxels[1, j], presses.link)
        difference = mean - readings[0, k, j]
        weight = 0.0
        # A saturated taxel only says "at least this".
        if readings[3, k, j] > 0 and not (readings[4, k, j] > 0 and difference > 0):
            own, grown = readings[1, k, j] * sigmas[2], readings[2, k, j] * sigmas[3]
            weight = 1.0 / math.sqrt(own * own + grown * grown)
        rate *= weight
        counts *= rate
        load *= rate
        by_u, by_v, ratio = counts * seen[1, j], counts * seen[2, j], counts * seen[4, j]
        slope, whole = found.nuisance_slope[i, j], found.macro_slope[i, j]
        slope[0], slope[1], slope[2] = cos * by_u - sin * by_v, sin * by_u + cos * by_v, load + ratio
        whole[0], whole[1] = counts * seen[5, j] - slope[0], counts * seen[6, j] - slope[1]
        whole[2], whole[3], whole[4] = counts * seen[3, j] + by_u * v - by_v * u, -ratio, load
        residual = weight * difference
        found.residual[i, j], found.level_slope[i, j] = residual, rate
        total += residual * residual
        for a in range(3):
            g[a] += slope[a] * residual
            for b in range(a + 1):
                hessian[a, b] += slope[a] * slope[b]
    for a in range(3):
        prior = 1.0 / sigmas[0 if a < 2 else 1] ** 2
        off = x[a] - at[3 + a]
        hessian[a, a] += prior
        g[a] += prior * off
        total += prior * off * off
        for b in range(a):
            hessian[b, a] = hessian[a, b]
    found.objective[i] = total


@inlined
def _step(hessian: Any, g: Any, damping: float, most: Any, out: Any) -> float:  # pragma: no cover - compiled
    """Fill ``out`` (3,) with a damped step, no axis longer than ``most``; return its longest, in parts of that."""
    d0 = (1.0 + damping) * hessian[0, 0]
    d1 = (1.0 + damping) * hessian[1, 1]
    d2 = (1.0 + damping) * hessian[2, 2]
    # L D L', row by row.
    a, b = hessian[1, 0] / d0, hessian[2, 0] / d0
    d1 -= a * hessian[1, 0]
    c = (hessian[2, 1] - b * hessian[1, 0]) / d1
    d2 -= b * hessian[2, 0] + c * c * d1
    y0 = -g[0]
    y1 = -g[1] - a * y0
    y2 = -g[2] - b * y0 - c * y1
    out[2] = y2 / d2
    out[1] = y1 / d1 - c * out[2]
    out[0] = y0 / d0 - a * out[1] - b * out[2]
    longest = 0.0
    for i in range(3):
        out[i] = min(max(out[i], -most[i]), most[i])
        longest = max(longest, abs(out[i]) / most[i])
    return longest


@compiled
def search(
    tables: Any,
    presses: Any,
    macro: Any,
    sigmas: Any,
    press: Any,
    start: Any,
    bound: Any,
    most: Any,
    iterations: int,
    to_rest: bool,
    found: Any,
) -> None:  # pragma: no cover - compiled
    """Gauss-Newton over the nuisance of n pairs of a macro draw and a press; the best point seen is kept.

    Full steps, not only downhill ones: the images hold a press on a thin curved sheet, and a step along it first
    leaves the sheet and is brought back by the next. Where the measured value is beyond what any place reaches, the
    residual does not vanish, and full steps go to and fro across the place; Levenberg's, downhill only, follow there.

    Args:
        tables: :class:`skincal.fitting.lookup.Tables`.
        presses: :class:`Presses`.
        macro: (n, 5) macro variables.
        sigmas: (n, 6) in the order of ``HYPER``, not their logarithms.
        press: (n,) which press.
        start: (n, 3) nuisance to start from.
        bound: (3,) of the nuisance.
        most: (3,) longest step of each.
        iterations: full steps at most; 0: only what is at the start.
        to_rest: whether Levenberg's steps follow.
        found: :class:`Found`, filled.
    """
    room, seen = room_for(tables), np.empty((7, presses.taxels.shape[1]))
    x, best, step = np.empty(3), np.empty(3), np.empty(3)
    g, best_g, best_hessian = np.empty(3), np.empty(3), np.empty((3, 3))
    for i in range(len(press)):
        least, full, descents, damping, last = np.inf, 0, 0, 0.3, False
        for a in range(3):
            x[a] = min(max(start[i, a], -bound[a]), bound[a])
            best[a] = x[a]
        while True:
            _evaluate(tables, presses, macro[i], sigmas[i], press[i], x, room, seen, i, found, g)
            if last:
                break
            better = found.objective[i] < least
            if better:
                least = found.objective[i]
                for a in range(3):
                    best[a], best_g[a] = x[a], g[a]
                    for b in range(3):
                        best_hessian[a, b] = found.hessian[i, a, b]
            moved = 0.0
            if full < iterations:
                _step(found.hessian[i], g, 1e-6 if full < _BLUNT_FROM else 1e-2, most, step)
                full += 1
                for a in range(3):
                    trial = min(max(x[a] + step[a], -bound[a]), bound[a])
                    moved = max(moved, abs(trial - x[a]) / most[a])
                    step[a] = trial
            elif to_rest and descents < _DESCENTS:
                if descents > 0:
                    damping *= 0.2 if better else 6.0
                moved = _step(best_hessian, best_g, damping, most, step)
                descents += 1
                for a in range(3):
                    step[a] = min(max(best[a] + step[a], -bound[a]), bound[a])
            if moved > _AT_REST:
                for a in range(3):
                    x[a] = step[a]
                continue
            if better:
                break
            last = True
            for a in range(3):
                x[a] = best[a]
