"""Residuals of presses, their slopes and their normal equations, compiled: :func:`skincal.fitting.presses.evaluate`."""

from __future__ import annotations

from typing import Any

import numpy as np

from skincal.fitting.lookup import compiled


@compiled
def expected(above: float, link: Any) -> Any:  # pragma: no cover - compiled
    """Mean count and slope for a value above the converter's bound: :class:`skincal.fitting.readings.Link`."""
    values, mean, slope = link
    if len(values) == 0:
        return above, 1.0
    step = values[1] - values[0]
    at = min(max((above - values[0]) / step, 0.0), len(values) - 1.001)
    low = int(at)
    part = at - low
    lift, next_lift = mean[low] - values[low], mean[low + 1] - values[low + 1]
    return above + lift + part * (next_lift - lift), slope[low] + part * (slope[low + 1] - slope[low])


@compiled
def add_up(
    seen: Any,
    scale: Any,
    gain: Any,
    rest: Any,
    readings: Any,
    link: Any,
    press: Any,
    sigmas: Any,
    off: Any,
    sums: Any,
    slopes: Any,
) -> None:  # pragma: no cover - compiled
    """Fill what is known of n presses.

    Args:
        seen: shares (n, J); slopes by contact and by centre (n, J, 2), by alpha and by log(F/E) (n, J).
        scale: (n,) counts that a whole load share stands for.
        gain: (J,) of the taxels.
        rest: (J,) level above the converter's bound [counts].
        readings: target, share of the noise, signal, which are used, which are saturated, each (K, J).
        link: of the converter.
        press: (n,) which press.
        sigmas: (n, 6).
        off: (n, 3) slack and force error, less their centre.
        sums: objective (n,), Hessian (n, 3, 3), residuals and simulated values (n, J): filled.
        slopes: of residuals by macro variables (n, J, 5), by slack and force (n, J, 3), by level (n, J): filled.
    """
    value, by_contact, by_centre, by_alpha, by_log_ratio = seen
    target, share, signal, used, saturated = readings
    objective, hessian, residual, simulated = sums
    macro_slope, own_slope, level_slope = slopes
    for i in range(len(press)):
        k = press[i]
        noise, misfit = sigmas[i, 2], sigmas[i, 3]
        total = 0.0
        hessian[i] = 0.0
        for j in range(len(gain)):
            counts = scale[i] * gain[j]
            load = counts * value[i, j]
            simulated[i, j] = load
            mean, rate = expected(load + rest[j], link)
            difference = mean - target[k, j]
            weight = 0.0
            # A saturated taxel only says "at least this".
            if used[k, j] and not (saturated[k, j] and difference > 0):
                own, grown = share[k, j] * noise, signal[k, j] * misfit
                weight = 1.0 / np.sqrt(own * own + grown * grown)
            rate *= weight
            counts *= rate
            ratio = counts * by_log_ratio[i, j]
            load *= rate
            residual[i, j] = weight * difference
            level_slope[i, j] = rate
            slope = own_slope[i, j]
            slope[0], slope[1], slope[2] = (
                counts * by_contact[i, j, 0], counts * by_contact[i, j, 1], load + ratio,
            )  # fmt: skip
            macro = macro_slope[i, j]
            macro[0], macro[1] = counts * by_centre[i, j, 0], counts * by_centre[i, j, 1]
            macro[2], macro[3], macro[4] = counts * by_alpha[i, j], -ratio, load
            total += residual[i, j] * residual[i, j]
            for a in range(3):
                for b in range(a + 1):
                    hessian[i, a, b] += slope[a] * slope[b]
        for a in range(3):
            prior = 1.0 / sigmas[i, 0 if a < 2 else 1] ** 2
            hessian[i, a, a] += prior
            total += prior * off[i, a] * off[i, a]
            for b in range(a):
                hessian[i, b, a] = hessian[i, a, b]
        objective[i] = total
