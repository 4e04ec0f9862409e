"""Residuals of presses, and the compiled search for their nuisance parameters: see :mod:`skincal.fitting.presses`."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from skincal.fitting.lookup import Tables, allocate_lookup, compiled, inlined, look_up
from skincal.fitting.types import Floats, Ints

_DESCENTS = 6
"""Most Levenberg steps."""
_BLUNT_FROM = 6
"""From this step on, Gauss-Newton is slightly damped."""
_AT_REST = 2e-4
"""A press has converged if its step is below this fraction of the largest step allowed."""


class Presses(NamedTuple):
    """Data of K presses and J taxels for the compiled search.

    Attributes:
        at: (K, 6) measured position across and along [m], log force [N], and the prior mean of slack [m] and
            log force error.
        which: (K, 2) indenter, and row in the session.
        readings: (5, K, J) target, share and signal of :class:`skincal.fitting.readings.Readings`; 1 where a
            reading counts; 1 where it is at the converter's upper bound.
        taxels: (2, J) gain, and rest level above the converter's lower bound [counts].
        link: (3, N) values, mean and slope of the converter's link.
        response: (4,) numbers of :class:`skincal.fitting.readings.Response`.
    """

    at: Floats
    which: Ints
    readings: Floats
    taxels: Floats
    link: Floats
    response: Floats

    def scattered_about(self, press: Ints, centre_m: Floats) -> Presses:
        """Return presses (n,), perhaps repeated, each with a prior mean of its slack (n, 2) [m] of its own."""
        at = self.at[press]
        at[:, 3:5] = centre_m
        readings = np.ascontiguousarray(self.readings[:, press])
        return self._replace(at=at, which=self.which[press], readings=readings)


@inlined
def apply_response(load: float, response: Any) -> Any:  # pragma: no cover - compiled
    """Return value and slope for a signal that is not negative: :class:`skincal.fitting.readings.Response`."""
    lost, knee, sharp, factor = response
    if lost == 0.0:
        return load, 1.0
    beyond = (max(load, 0.0) / knee) ** sharp
    share = factor * (1.0 + beyond) ** (-lost / sharp)
    return load * share, share * (1.0 - lost * beyond / (1.0 + beyond))


@inlined
def expected_count(above: float, link: Any) -> Any:  # pragma: no cover - compiled
    """Return mean count and slope for a value above the converter's bound: :class:`skincal.fitting.readings.Link`."""
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
def _evaluate_unloaded(presses: Any, sigmas: Any, k: int, dark: Any) -> float:  # pragma: no cover - compiled
    """Fill ``dark`` (3, J) for press ``k`` without load: residuals, slopes by the rest level, and weights.

    Returns:
        The sum of the squared residuals.
    """
    readings, total = presses.readings, 0.0
    for j in range(presses.taxels.shape[1]):
        mean, rate = expected_count(presses.taxels[1, j], presses.link)
        weight = 0.0
        if readings[3, k, j] > 0:
            own, grown = readings[1, k, j] * sigmas[2], readings[2, k, j] * sigmas[3]
            weight = 1.0 / math.sqrt(own * own + grown * grown)
        difference = mean - readings[0, k, j]
        # A saturated reading is only a lower bound.
        read = 0.0 if readings[4, k, j] > 0 and difference > 0 else weight
        dark[0, j], dark[1, j], dark[2, j] = read * difference, read * rate, weight
        total += dark[0, j] * dark[0, j]
    return total


@inlined
def _evaluate(
    tables: Any,
    presses: Any,
    macro: Any,
    sigmas: Any,
    k: int,
    x: Any,
    workspace: Any,
    count: int,
    i: int,
    whole: bool,
    found: Any,
    g: Any,
) -> int:  # pragma: no cover - compiled
    """Fill Q and its Hessian in row ``i`` of ``found`` for press ``k`` at nuisance ``x``, and half the gradient ``g``.

    ``workspace`` has cosine and sine of alpha, the sum of squares without load, ``dark`` of
    :func:`_evaluate_unloaded`, and the arrays of the look-up. ``count`` is the number of taxels of the last
    look-up if that was at ``x``, -1 to look up anew; that of the contact is returned. With ``whole`` all columns
    of the row are filled.
    """
    (cos, sin), total, dark, looked, near, seen = workspace
    at, readings = presses.at[k], presses.readings
    across, along = at[0] + x[0] - macro[0], at[1] + x[1] - macro[1]
    u, v = across * cos + along * sin, along * cos - across * sin
    log_ratio = at[2] + x[2] - macro[3]
    if count < 0:
        kind, row = presses.which[k, 0], presses.which[k, 1]
        count = look_up(tables, kind, row, macro, u, v, log_ratio, looked, near, seen)
    scale = math.exp(macro[4] + x[2] + at[2])
    for a in range(3):
        found.nuisance[i, a] = x[a]
    if whole:
        found.uv_m[i, 0], found.uv_m[i, 1] = u, v
        for j in range(dark.shape[1]):
            found.simulated[i, j], found.residual[i, j], found.level_slope[i, j] = 0.0, dark[0, j], dark[1, j]
            for a in range(3):
                found.nuisance_slope[i, j, a] = 0.0
            for a in range(5):
                found.macro_slope[i, j, a] = 0.0
    g0 = g1 = g2 = h00 = h10 = h11 = h20 = h21 = h22 = 0.0
    for n in range(count):
        j = near[n]
        counts = scale * presses.taxels[0, j]
        load = counts * seen[0, j]
        value, gain = apply_response(load, presses.response)
        mean, rate = expected_count(value + presses.taxels[1, j], presses.link)
        difference, weight = mean - readings[0, k, j], dark[2, j]
        if whole:
            found.simulated[i, j] = value
        if readings[4, k, j] > 0 and difference > 0:
            weight = 0.0
        rate *= weight
        counts *= rate * gain
        load *= rate * gain
        by_u, by_v, ratio = counts * seen[1, j], counts * seen[2, j], counts * seen[4, j]
        s0, s1, s2 = cos * by_u - sin * by_v, sin * by_u + cos * by_v, load + ratio
        residual = weight * difference
        total += residual * residual - dark[0, j] * dark[0, j]
        g0 += s0 * residual
        g1 += s1 * residual
        g2 += s2 * residual
        h00 += s0 * s0
        h10 += s1 * s0
        h11 += s1 * s1
        h20 += s2 * s0
        h21 += s2 * s1
        h22 += s2 * s2
        if whole:
            found.residual[i, j], found.level_slope[i, j] = residual, rate
            slope, macros = found.nuisance_slope[i, j], found.macro_slope[i, j]
            slope[0], slope[1], slope[2] = s0, s1, s2
            macros[0], macros[1] = counts * seen[5, j] - s0, counts * seen[6, j] - s1
            macros[2], macros[3], macros[4] = counts * seen[3, j] + by_u * v - by_v * u, -ratio, load
    hessian = found.hessian[i]
    hessian[0, 0], hessian[1, 0], hessian[1, 1] = h00, h10, h11
    hessian[2, 0], hessian[2, 1], hessian[2, 2] = h20, h21, h22
    g[0], g[1], g[2] = g0, g1, g2
    for a in range(3):
        prior = 1.0 / sigmas[0 if a < 2 else 1] ** 2
        off = x[a] - at[3 + a]
        hessian[a, a] += prior
        g[a] += prior * off
        total += prior * off * off
        for b in range(a):
            hessian[b, a] = hessian[a, b]
    found.objective[i] = total
    return count


@inlined
def _step(hessian: Any, g: Any, damping: float, most: Any, out: Any) -> float:  # pragma: no cover - compiled
    """Fill ``out`` (3,) with a damped step, clipped to ``most`` in each axis; return its largest ratio to ``most``."""
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


def allocate_workspace(tables: Tables, taxels: int) -> tuple[Any, ...]:
    """Return the arrays that :func:`search` works in."""
    looked = allocate_lookup(tables), np.empty(taxels, dtype=np.int64), np.empty((7, taxels))
    return np.empty((3, taxels)), *looked, *np.empty((5, 3)), np.empty((3, 3))


@compiled
def search(
    tables: Any,
    presses: Any,
    press: Any,
    start: Any,
    bound: Any,
    most: Any,
    iterations: int,
    to_rest: bool,
    found: Any,
    workspace: Any,
) -> None:  # pragma: no cover - compiled
    """Run Gauss-Newton over the nuisance of n pairs of a macro draw and a press; keep the best point seen.

    Full steps are taken even if they go uphill. The images confine a press to a thin curved sheet: a step
    along the sheet leaves it first, and the next step returns to it. If the measured value is beyond what any
    position reaches, the residual does not vanish, and full steps oscillate about the solution. Levenberg
    steps, downhill only, then follow.

    Args:
        tables: :class:`skincal.fitting.lookup.Tables`.
        presses: :class:`Presses`.
        press: (n,) number of the press.
        start: (n, 3) nuisance.
        bound: (3,) bound of the nuisance.
        most: (3,) longest step along each axis.
        iterations: most full steps; 0 to evaluate the start only.
        to_rest: whether Levenberg steps follow.
        found: :class:`skincal.fitting.presses.PressStates` with macro variables and sigmas given; the rest is
            filled.
        workspace: from :func:`allocate_workspace`.
    """
    dark, looked, near, seen, x, best, step, g, best_g, best_hessian = workspace
    whole, total = len(found.residual) > 0, 0.0
    for i in range(len(press)):
        k, own, spread = press[i], found.macro[i], found.sigmas[i]
        same = i > 0 and k == press[i - 1]
        for a in range(len(spread)):
            same = same and spread[a] == found.sigmas[i - 1, a]
        if not same:
            total = _evaluate_unloaded(presses, spread, k, dark)
        now = (math.cos(own[2]), math.sin(own[2])), total, dark, looked, near, seen
        least, full, descents, damping, last, known = np.inf, 0, 0, 0.3, iterations == 0, -1
        for a in range(3):
            x[a] = min(max(start[i, a], -bound[a]), bound[a])
            best[a] = x[a]
        while True:
            count = _evaluate(tables, presses, own, spread, k, x, now, known, i, last and whole, found, g)
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
            if better and not whole:
                break
            last, known = True, count if better else -1
            for a in range(3):
                x[a] = best[a]
