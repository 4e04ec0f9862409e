"""The compiled micro problems of the grid: every press under every centre of the sensor, at one turn and one E.

For one press with observed image D, simulated shares g and the best amplitude c >= 0, the objective is

    Q(delta) = |c g(delta) - D|^2 / sigma^2 + |delta|^2 / sigma_p^2,    |delta_i| <= slack

(:mod:`skincal.fitting.general`). A lattice of contacts that all centres share is looked up, to the nearest node.
Gauss-Newton continues from the best node, with the amplitude eliminated (variable projection, Kaufman 1975). It
takes full steps even uphill: if two taxels respond, Q is a thin curved valley, and a step along the valley
leaves it first, and the next step returns to it. The best point seen is kept.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from skincal.fitting.lookup import compiled, inlined, look_up_level

ITERATIONS = 8
"""Most Gauss-Newton steps."""

MOST_STEP_M = 0.5e-3
"""Longest Gauss-Newton step along one direction [m]."""
_REST_M = 1e-6
"""Step at which Gauss-Newton has converged [m]."""
_TINY = 1e-12
"""Least power of an image, against division by zero."""


@inlined
def mismatches(
    tables: Any, weight: Any, observed: Any, across: Any, along: Any, turn: Any, out: Any
) -> None:  # pragma: no cover - compiled
    """Fill ``out`` (P, Q) with D^2 (1 - cos^2) [counts²] of one press on a lattice of contacts, to the nearest node.

    Args:
        tables: planes, sizes, centres and lattice as for :func:`skincal.fitting.lookup.look_up_level`, and the
            number of the press.
        weight: (J,) of the readings.
        observed: (J,) weighted image.
        across: (P,) contacts from the centre [m].
        along: (Q,) the same.
        turn: cosine and sine of alpha.
        out: filled.
    """
    planes, size_of, centres, lattice, press = tables
    step, half, reaches = lattice
    reach, (cos, sin) = reaches[press], turn
    total = 0.0
    for j in range(len(observed)):
        total += observed[j] * observed[j]
    for p in range(len(across)):
        for q in range(len(along)):
            u, v = across[p] * cos + along[q] * sin, along[q] * cos - across[p] * sin
            power = product = 0.0
            for j in range(len(centres)):
                du, dv = u - centres[j, 0], v - centres[j, 1]
                if abs(du) < reach and abs(dv) < reach:
                    row, col = int((du + half) / step + 0.5), int((dv + half) / step + 0.5)
                    g = weight[j] * planes[press, size_of[j], row, col]
                    power += g * g
                    product += g * observed[j]
            out[p, q] = total
            if power > _TINY and product > 0.0:
                out[p, q] -= product * product / power


@inlined
def descend(
    tables: Any,
    weight: Any,
    observed: Any,
    at: Any,
    turn: Any,
    settings: Any,
    slack: Any,
    workspace: Any,
    shares: Any,
) -> float:  # pragma: no cover - compiled
    """Run Gauss-Newton from ``slack`` (2,), and move it to the best point seen; return Q there.

    Arguments as for :func:`mismatches`, and ``at``, the contact from the centre across and along, at slack zero
    [m]; ``settings``: 1 / sigma² [1/counts²], 1 / sigma_p² [1/m²], bound of the slack [m]; ``workspace``: arrays
    (3, J) and (J,). ``shares`` (J,) is filled with the weighted load shares at the best point.
    """
    planes, size_of, centres, lattice, press = tables
    cos, sin = turn
    certain, stiff, most = settings
    image, near = workspace
    x, y = slack[0], slack[1]
    best = np.inf
    for _ in range(ITERATIONS + 1):
        a, o = at[0] + x, at[1] + y
        count = look_up_level(
            planes, size_of, centres, lattice, a * cos + o * sin, o * cos - a * sin, press, near, image
        )
        power = product = gx = gy = 0.0
        for n in range(count):
            j = near[n]
            w = weight[j]
            g, by_u, by_v = w * image[0, j], w * image[1, j], w * image[2, j]
            dx, dy = cos * by_u - sin * by_v, sin * by_u + cos * by_v
            image[0, j], image[1, j], image[2, j] = g, dx, dy
            power += g * g
            product += g * observed[j]
            gx += g * dx
            gy += g * dy
        c = max(product, 0.0) / power if power > _TINY else 0.0
        power = max(power, _TINY)
        misfit = xx = xy = yy = rx = ry = 0.0
        for j in range(len(weight)):
            r = c * image[0, j] - observed[j]
            misfit += r * r
        gx, gy = gx / power, gy / power
        for n in range(count):
            j = near[n]
            g = image[0, j]
            r = c * g - observed[j]
            jx, jy = c * (image[1, j] - g * gx), c * (image[2, j] - g * gy)
            xx += jx * jx
            xy += jx * jy
            yy += jy * jy
            rx += jx * r
            ry += jy * r
        q = certain * misfit + stiff * (x * x + y * y)
        if q < best:
            best = q
            slack[0], slack[1] = x, y
            for j in range(len(weight)):
                shares[j] = image[0, j]
        xx, xy, yy = certain * xx + stiff, certain * xy, certain * yy + stiff
        rx, ry = certain * rx + stiff * x, certain * ry + stiff * y
        # If the image has no gradient and there is no prior, damping keeps the step finite.
        floor = 1e-4 * (xx + yy) + 1.0
        xx, yy = xx + floor, yy + floor
        determinant = xx * yy - xy * xy
        step_x = min(max(-(yy * rx - xy * ry) / determinant, -MOST_STEP_M), MOST_STEP_M)
        step_y = min(max(-(xx * ry - xy * rx) / determinant, -MOST_STEP_M), MOST_STEP_M)
        new_x, new_y = min(max(x + step_x, -most), most), min(max(y + step_y, -most), most)
        if abs(new_x - x) <= _REST_M and abs(new_y - y) <= _REST_M:
            break
        x, y = new_x, new_y
    return best


@compiled
def place(
    tables: Any,
    images: Any,
    lattice: Any,
    at_zero: Any,
    window: Any,
    stride: Any,
    how: Any,
    found: Any,
    workspace: Any,
) -> None:  # pragma: no cover - compiled
    """Place every press (K,) for every centre (X, Y) of the sensor.

    Args:
        tables: planes, sizes, centres and lattice as for :func:`mismatches`, at this turn and E.
        images: weights of the readings (K, J), and weighted images (K, J).
        lattice: contacts from the sensor's centre across (K, P) and along (K, Q), last centre first [m].
        at_zero: contacts from the centre at slack zero, across (K, X) and along (K, Y) [m].
        window: slacks (W,) and (V,) of the lattice's nodes around a centre [m].
        stride: nodes from centre to centre, across and along.
        how: cosine and sine of alpha, and settings as for :func:`descend`.
        found: slacks (K, X, Y, 2) [m] and weighted load shares there (K, X, Y, J), filled.
        workspace: arrays (P, Q), twice (Y, P), and those of :func:`descend`.
    """
    planes, size_of, centres, step_and_half = tables
    (weight, observed), (across, along), (grid_across, grid_along) = images, lattice, at_zero
    (wide, long), (turn, settings), (slack, shares) = window, how, found
    mismatch, row, at_row, own_workspace = workspace
    certain, stiff, _ = settings
    last_x, last_y = grid_across.shape[1] - 1, grid_along.shape[1] - 1
    for k in range(len(weight)):
        one = planes, size_of, centres, step_and_half, k
        mismatches(one, weight[k], observed[k], across[k], along[k], turn, mismatch)
        # The prior is a sum over both directions, so the best slack along y is the same for all
        # centres across.
        for y in range(last_y + 1):
            second = (last_y - y) * stride[1]
            for p in range(across.shape[1]):
                least, best = np.inf, 0.0
                for o in range(len(long)):
                    q = certain * mismatch[p, second + o] + stiff * long[o] * long[o]
                    if q < least:
                        least, best = q, long[o]
                row[y, p], at_row[y, p] = least, best
        for x in range(last_x + 1):
            first = (last_x - x) * stride[0]
            for y in range(last_y + 1):
                least, own = np.inf, slack[k, x, y]
                for i in range(len(wide)):
                    q = row[y, first + i] + stiff * wide[i] * wide[i]
                    if q < least:
                        least = q
                        own[0], own[1] = wide[i], at_row[y, first + i]
                at = grid_across[k, x], grid_along[k, y]
                descend(one, weight[k], observed[k], at, turn, settings, own, own_workspace, shares[k, x, y])
