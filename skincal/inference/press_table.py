"""Loads of every press as a function of its force: tabulated once for a pose, looked up for every frame.

Under a given stress law the loads of a press over E are smooth functions of F / E alone. For each press the loads of
all taxels are computed at some values of F / E, and again with the contact moved to the six places of a small lattice,
which gives slopes and second slopes by the move. A frame is then a look-up, and so are its slopes by force, E and
place.

For spheres a compiled loop sums the loads (points sorted by the depth at which they are met, running sums of area and
moment); other indenters use :class:`skincal.model.Skin`.
"""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from skincal.fitting.lookup import allocating
from skincal.model import (
    ContactLaw,
    Contacts,
    FlatPunch,
    Indenter,
    Patch,
    Skin,
    SkinParameters,
    Sphere,
    StressLaw,
    Surface,
    contact_rotations,
)
from skincal.model.arrays import FloatArray, IntArray
from skincal.workers.processes import available_cores

NODES = 22
"""Number of values of F / E in a table, equally spaced in the square root."""
STEP_M = 2.5e-4
"""Spacing of the lattice of places [m]."""
_FEW_CELLS = 3
"""Largest rise of the gap over a point's cell, in sides of the cell."""
_FELT = 1e-7
"""Part of a point's load below which a taxel is taken not to feel it, which shortens the sums."""
_FLAT_M = 1e-6
"""Tolerance of a flat patch [m]."""
_LATTICE = ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1), (1, 1))


@dataclass(frozen=True, eq=False)
class PressTable:
    """Loads over E [m³] of P presses.

    Attributes:
        terms: (6, P, K, J): value, slopes by the move across and along, second slopes (across², along², both).
        most_m3: (P,) largest F / E of each press.
    """

    terms: FloatArray
    most_m3: FloatArray

    def at(self, row: IntArray, load_m3: FloatArray, move_m: FloatArray | None = None) -> FloatArray:
        """Look up loads over E (M, J) of frames.

        Args:
            row: (M,) press of each frame.
            load_m3: (M,) F / E.
            move_m: (M, 2) offset of the contact from the table's place; None: zero.
        """
        terms = self.terms if move_m is not None else self.terms[:1]
        move = np.zeros((len(row), 2)) if move_m is None else move_m
        return _look_up(terms, row, load_m3, self.most_m3, move, False)[0]

    def with_slopes(self, row: IntArray, load_m3: FloatArray, move_m: FloatArray) -> FloatArray:
        """Look up loads over E of frames, and slopes by the move across and along and the logarithm of F: (4, M, J)."""
        return _look_up(self.terms, row, load_m3, self.most_m3, move_m, True)

    def curved(self) -> PressTable:
        """Return the change by one unit of spreading: half a squared lattice step times the sum of second slopes."""
        return PressTable((self.terms[3] + self.terms[4])[None] * STEP_M**2 / 2, self.most_m3)

    def spread(self, much: float) -> PressTable:
        """Return the table of spread loads; slopes stay those without spreading."""
        terms = self.terms.copy()
        terms[0] += much * self.curved().terms[0]
        return replace(self, terms=terms)


@dataclass(frozen=True, eq=False)
class Presses:
    """P presses as measured.

    Attributes:
        points_m: (P, 3) contact points.
        normals: (P, 3) directions of the force.
        indenter: (P,) index of the indenter.
        most_n: (P,) largest force that a table must hold.
    """

    points_m: FloatArray
    normals: FloatArray
    indenter: IntArray
    most_n: FloatArray

    def of(self, rows: IntArray) -> Presses:
        """Select presses."""
        return Presses(self.points_m[rows], self.normals[rows], self.indenter[rows], self.most_n[rows])

    def moved(self, surface: Surface, move_m: FloatArray) -> Presses:
        """Move contacts over the surface (P, 2) across and along; normals turn with the surface's."""
        old = surface.project(self.points_m)
        new = surface.offset(old, move_m[:, 0], move_m[:, 1])
        turned = self.normals + surface.normal_at(new) - surface.normal_at(old)
        turned /= np.linalg.norm(turned, axis=1, keepdims=True)
        return replace(self, points_m=self.points_m + new - old, normals=turned)

    def axes(self, surface: Surface) -> FloatArray:
        """Return unit vectors (P, 2, 3) across and along at each contact."""
        return np.swapaxes(contact_rotations(surface.normal_at(surface.project(self.points_m))), 1, 2)[:, :2]


def press_table(
    patch: Patch,
    surface: Surface,
    indenters: tuple[Indenter, ...],
    presses: Presses,
    elasticity_pa_per_m: float,
    law: StressLaw | None = None,
    weights: FloatArray | None = None,
    *,
    contact: ContactLaw | None = None,
    bare: float = 0.0,
    lattice: bool = True,
) -> PressTable:
    """Compute a table.

    Args:
        patch: tactile points.
        surface: that carries them.
        indenters: that press.
        presses: contacts and largest forces.
        elasticity_pa_per_m: E, for the largest F / E.
        law: stress law of an effect; None: proportional to penetration.
        weights: (N, J) part of each point's load that a taxel feels; None: that of its own points.
        contact: contact law; the caller adds its spreading.
        bare: part of the unprojected pressure in what a taxel feels, under spheres; 0 projects pressure twice.
        lattice: True if slopes by the place are wanted.
    """
    most = presses.most_n / elasticity_pa_per_m
    if _covers(indenters, patch, presses):
        own = weights.T @ patch.areas_m2 if weights is not None else _by_taxel(patch)
        even = (
            most[:, None, None]
            * ((np.arange(NODES) / (NODES - 1)) ** 2)[:, None]
            * own
            / patch.areas_m2.sum()
        )
        return PressTable(np.stack([even, *[np.zeros_like(even)] * (5 if lattice else 0)]), most)
    contact, count, places = contact or ContactLaw(), len(most), len(_LATTICE)
    if not lattice:
        return PressTable(_loads(patch, indenters, presses, most, law, weights, contact, bare)[None], most)
    moved = presses.of(np.tile(np.arange(count), places))
    moved = moved.moved(surface, STEP_M * np.repeat(_LATTICE, count, axis=0))
    found = _loads(patch, indenters, moved, np.tile(most, places), law, weights, contact, bare)
    c, e, w, n, s, ne = found.reshape(places, count, *found.shape[1:])
    h = STEP_M
    terms = [
        c,
        (e - w) / (2 * h),
        (n - s) / (2 * h),
        (e + w - 2 * c) / (2 * h * h),
        (n + s - 2 * c) / (2 * h * h),
    ]
    return PressTable(np.stack([*terms, (ne - e - n + c) / (h * h)]), most)


def _covers(indenters: tuple[Indenter, ...], patch: Patch, presses: Presses) -> bool:
    """Return whether every press is a flat punch over all of a flat patch: then the load is even, by any law."""
    if not len(presses.normals) or not all(isinstance(one, FlatPunch) for one in indenters):
        return False
    radius = np.array([one.radius_m for one in indenters if isinstance(one, FlatPunch)])[presses.indenter]
    up = patch.normals[0]
    flat = np.ptp(patch.points_m @ up) < _FLAT_M and (patch.normals @ up > 1 - 1e-9).all()
    if not flat or not (presses.normals @ up > 1 - 1e-9).all():
        return False
    middle = (patch.points_m.min(axis=0) + patch.points_m.max(axis=0)) / 2
    reach = np.linalg.norm(patch.points_m - middle, axis=1).max() + 2 * STEP_M
    return bool((np.linalg.norm(presses.points_m - middle, axis=1) + reach <= radius).all())


def _by_taxel(patch: Patch) -> FloatArray:
    """Return the area (J,) of each taxel's points [m²]."""
    on = patch.taxel >= 0
    return np.bincount(patch.taxel[on], patch.areas_m2[on], patch.layout.taxels).astype(np.float64)


def _loads(
    patch: Patch,
    indenters: tuple[Indenter, ...],
    presses: Presses,
    most: FloatArray,
    law: StressLaw | None,
    weights: FloatArray | None,
    contact: ContactLaw,
    bare: float,
) -> FloatArray:
    share = (np.arange(NODES) / (NODES - 1)) ** 2
    out = np.zeros((len(most), NODES, patch.layout.taxels if weights is None else weights.shape[1]))
    stress = contact.stress(law)
    power, reference = (1.0, 1.0) if stress is None else (stress.exponent, stress.reference_m)
    on = _on_taxels(patch, weights)
    for number, indenter in enumerate(indenters):
        rows = np.flatnonzero(presses.indenter == number)
        stiff, indenter = contact.stiffness(indenter, law), contact.equivalent_indenter(indenter)
        if isinstance(indenter, Sphere):

            def balls(rows: IntArray, radius: float = indenter.radius_m, stiff: float = stiff) -> None:
                normals = presses.normals[rows]
                out[rows] = stiff * _balls(
                    patch.points_m, patch.normals, patch.areas_m2, on,
                    presses.points_m[rows] + radius * normals, normals, radius, most[rows] / stiff, share,
                    out.shape[2], power, reference, bare,
                )  # fmt: skip

            parts = np.array_split(rows, min(available_cores(), len(rows)) or 1)
            list(_threads(os.getpid()).map(balls, parts))
        elif len(rows):
            _cast(out, patch, indenter, presses, rows, most, stress, weights)
    return out


@cache
def _threads(process: int) -> ThreadPoolExecutor:
    """Return the threads of a process: a fork does not inherit its parent's, and would wait for them for ever."""
    return ThreadPoolExecutor(available_cores(), thread_name_prefix="press tables")


def _on_taxels(patch: Patch, weights: FloatArray | None) -> tuple[IntArray, IntArray, FloatArray]:
    """Return the taxels of each point: begin (N + 1,) in a list, the list, and the part of the load each feels."""
    if weights is None:
        feels = patch.taxel >= 0
        return np.append(0, np.cumsum(feels)), patch.taxel[feels], np.ones(int(feels.sum()))
    point, taxel = np.nonzero(np.abs(weights) > _FELT)
    begin = np.searchsorted(point, np.arange(len(weights) + 1))
    return begin, taxel, np.ascontiguousarray(weights[point, taxel])


def _cast(
    out: FloatArray,
    patch: Patch,
    indenter: Indenter,
    presses: Presses,
    rows: IntArray,
    most: FloatArray,
    law: StressLaw | None,
    weights: FloatArray | None,
) -> None:
    """Compute loads (P, K, J) of presses by any indenter; presses at one place share their rays."""
    share = np.arange(NODES) / (NODES - 1)
    skin = Skin(patch, SkinParameters(1.0, 1.0), law=law)
    place = np.round(np.hstack([presses.points_m[rows] * 1e6, presses.normals[rows] * 1e6]))
    _, group = np.unique(place, axis=0, return_inverse=True)
    for g in range(int(group.max()) + 1):
        mine = rows[group.reshape(-1) == g]
        top = float(most[mine].max())
        roots = np.sqrt(top) * (share if len(mine) == 1 else np.linspace(0.0, 1.0, 3 * NODES))
        k = np.full(len(roots), mine[0])
        contacts = Contacts(presses.points_m[k], presses.normals[k], roots**2)
        pressed = (
            skin.loads(indenter, contacts)
            if weights is None
            else skin.pressures(indenter, contacts).loads(weights)
        )
        for p in mine.tolist():
            asked = np.sqrt(most[p]) * share
            out[p] = (
                pressed
                if len(mine) == 1
                else np.stack([np.interp(asked, roots, own) for own in pressed.T], axis=1)
            )


@allocating
def _by_size(values, count, below):
    """Return the indices of the first values below a bound, ascending: Shell's sort; numba's compiles slowly."""
    order = np.empty(count, np.int64)
    n = 0
    for i in range(count):
        if values[i] < below:
            order[n] = i
            n += 1
    step = 1
    while 3 * step + 1 < n:
        step = 3 * step + 1
    while step > 0:
        for i in range(step, n):
            own = order[i]
            k = i
            while k >= step and values[order[k - step]] > values[own]:
                order[k] = order[k - step]
                k -= step
            order[k] = own
        step //= 3
    return order[:n]


@allocating
def _balls(points, normals, areas, on, centres, ups, radius, most, share, taxels, power, reference, bare):
    (begin, taxel, part), count, nodes = on, len(centres), len(share)
    out = np.zeros((count, nodes, taxels))
    n = len(points)
    # Tabulated stress and its integral over depth: powers would take most of the time.
    knots = 512
    inside, upto = np.empty(knots + 2), np.empty(knots + 2)
    for k in range(len(inside)):
        inside[k] = (k / knots) ** power
        upto[k] = inside[k] * k / (power + 1)
    gap, area, face, which = np.empty(n), np.empty(n), np.empty(n), np.empty(n, np.int64)
    squares, depth = np.empty(n), np.empty(n)
    px, py, pz = points[:, 0].copy(), points[:, 1].copy(), points[:, 2].copy()
    for c in range(count):
        ux, uy, uz = ups[c, 0], ups[c, 1], ups[c, 2]
        if not (np.isfinite(ux + centres[c, 0] + centres[c, 1] + centres[c, 2]) and most[c] > 0):
            continue
        # Points within reach: beyond, the gap is larger than any depth.
        wide = (radius + 1e-4) ** 2 + 4 * radius * np.sqrt(most[c] / (np.pi * radius))
        m, first = 0, np.inf
        cx, cy, cz = centres[c, 0], centres[c, 1], centres[c, 2]
        for i in range(n):  # by itself, which processors do for several points at a time
            squares[i] = (px[i] - cx) ** 2 + (py[i] - cy) ** 2 + (pz[i] - cz) ** 2
        for i in range(n):
            away = squares[i]
            if away > wide:
                continue
            x, y, z = px[i] - cx, py[i] - cy, pz[i] - cz
            along = x * ux + y * uy + z * uz
            half = along * along - away + radius * radius
            if half <= 0:
                continue
            w = areas[i] * (normals[i, 0] * ux + normals[i, 1] * uy + normals[i, 2] * uz)
            if w <= 0:
                continue
            root = np.sqrt(half)
            gap[m], area[m], which[m], depth[m] = -along - root, w, i, root
            first = min(first, gap[m])
            m += 1
        if m == 0:
            continue
        reach = 1.25 * np.sqrt(most[c] / (np.pi * radius))
        while True:
            carried = 0.0
            for i in range(m):
                u = (first + reach - gap[i]) / reach * knots
                if u > 0:
                    k = int(u)
                    carried += area[i] * (inside[k] + (u - k) * (inside[k + 1] - inside[k]))
            carried *= reference * (reach / reference) ** power
            if carried >= most[c] or reach > 0.02:
                break
            # Extrapolate the depth from one that carries nearly enough: the load is a power of the depth.
            short = most[c] / carried if carried > 0 else 10.0
            reach *= min(1.5, 1.05 * short ** (1 / (power + 1)))
        if power != 1.0 and carried > 1.2 * most[c]:
            reach *= 1.1 * (most[c] / carried) ** (1 / (power + 1))
        for i in range(m):
            face[i] = (1 - bare) * depth[i] / radius + bare * areas[which[i]] / area[i]
        if power == 1.0:
            order = _by_size(gap, m, first + reach)
            heavy, moment = np.zeros(taxels), np.zeros(taxels)
            total, lever, at = 0.0, 0.0, 0
            for k in range(1, nodes):
                load = most[c] * share[k]
                while at < len(order) and (total == 0.0 or gap[order[at]] * total - lever < load):
                    i = order[at]
                    total += area[i]
                    lever += area[i] * gap[i]
                    f = area[i] * face[i]
                    for e in range(begin[which[i]], begin[which[i] + 1]):
                        heavy[taxel[e]] += f * part[e]
                        moment[taxel[e]] += f * part[e] * gap[i]
                    at += 1
                level = (load + lever) / total
                for j in range(taxels):
                    out[c, k, j] = max(level * heavy[j] - moment[j], 0.0)
            continue
        # Other laws: loads at some depths (in knots), interpolated to the nodes.
        steps, per_m = 2 * nodes // 3, knots / reach
        whole, bent = reference * (reach / reference) ** power, power * (power - 1) / 6
        carry, own = np.zeros(steps), np.zeros((steps, taxels))
        levels = np.array([knots * (s / (steps - 1)) ** (2 / (power + 1)) for s in range(steps)])
        for i in range(m):
            # The mean over the cell: a stress that begins steeply would jump with each point in contact.
            q, met = which[i], (gap[i] - first) * per_m
            if gap[i] - first > reach + _FEW_CELLS * np.sqrt(areas[q]):
                continue
            x, y, z = px[q] - cx, py[q] - cy, pz[q] - cz
            along, up = x * ux + y * uy + z * uz, area[i] / areas[q]
            # Rise of the gap over half of a point's cell, away from the axis, limited to the sphere.
            aside = np.sqrt(max(squares[q] - along * along, 1e-18))
            tilt = normals[q, 0] * x + normals[q, 1] * y + normals[q, 2] * z - up * along
            steep = (up * aside * aside + tilt * depth[i]) / (up * aside * depth[i])
            rise = max(min(0.5 * np.sqrt(area[i]) * abs(steep), depth[i]) * per_m, 1e-4)
            if met - rise >= levels[steps - 1]:
                continue
            f = whole * area[i] / (2 * rise)
            for s in range(steps - 1, 0, -1):
                deep = levels[s] - met
                if deep <= -rise:
                    break
                if deep > 2 * rise:  # the middle's, and what it is bent by over the cell
                    k = min(int(deep), knots)
                    mean = inside[k] + (deep - k) * (inside[k + 1] - inside[k])
                    mean *= 2 * rise * (1 + bent * (rise / deep) ** 2)
                else:
                    mean = 0.0
                    for side in (1, -1):
                        u = deep + side * rise
                        if u > 0:
                            k = min(int(u), knots)
                            t, here = u - k, inside[k]
                            mean += side * (upto[k] + t * (here + t * (upto[k + 1] - upto[k] - here)))
                load = f * mean
                carry[s] += load
                load *= face[i]
                for e in range(begin[q], begin[q + 1]):
                    own[s, taxel[e]] += load * part[e]
        # Cubic interpolation in square roots of load and force, which are nearly proportional.
        root, own = np.sqrt(carry), np.sqrt(own)
        s = 2
        for k in range(1, nodes):
            wanted = np.sqrt(most[c] * share[k])
            while s < steps - 2 and root[s] < wanted:
                s += 1
            for a in range(s - 2, s + 2):
                weight = 1.0
                for b in range(s - 2, s + 2):
                    if b != a:
                        weight *= (wanted - root[b]) / (root[a] - root[b])
                for j in range(taxels):
                    out[c, k, j] += weight * own[a, j]
            for j in range(taxels):
                out[c, k, j] = max(out[c, k, j], 0.0) ** 2
    return out


@allocating
def _look_up(terms, row, load, most, move, sloped):
    """Interpolate: cubic through four nodes in the square root, linear beyond the last; with slopes or without."""
    orders, nodes, taxels = terms.shape[0], terms.shape[2], terms.shape[3]
    out = np.zeros((4 if sloped else 1, len(row), taxels))
    w, by, g = np.empty(4), np.empty(4), np.zeros((6, 3))
    for f in range(len(row)):
        p = row[f]
        if p < 0 or not load[f] > 0 or most[p] <= 0:
            continue
        u = np.sqrt(load[f] / most[p]) * (nodes - 1)
        k = min(max(int(u) - 1, 0), nodes - 4)
        t = u - k
        if u > nodes - 1:
            a = u - (nodes - 1)
            w[0], w[1], w[2], w[3] = 0.0, 0.0, -a, 1.0 + a
            by[0], by[1], by[2], by[3] = 0.0, 0.0, -1.0, 1.0
        else:
            w[0] = -(t - 1) * (t - 2) * (t - 3) / 6
            w[1] = t * (t - 2) * (t - 3) / 2
            w[2] = -t * (t - 1) * (t - 3) / 2
            w[3] = t * (t - 1) * (t - 2) / 6
            by[0] = -((t - 2) * (t - 3) + (t - 1) * (t - 3) + (t - 1) * (t - 2)) / 6
            by[1] = ((t - 2) * (t - 3) + t * (t - 3) + t * (t - 2)) / 2
            by[2] = -((t - 1) * (t - 3) + t * (t - 3) + t * (t - 1)) / 2
            by[3] = ((t - 1) * (t - 2) + t * (t - 2) + t * (t - 1)) / 6
        a, b = move[f, 0], move[f, 1]
        # Monomials of the move for each term, and their slopes.
        g[0, 0], g[1, 0], g[2, 0], g[3, 0], g[4, 0], g[5, 0] = 1.0, a, b, a * a, b * b, a * b
        g[1, 1], g[3, 1], g[5, 1] = 1.0, 2 * a, b
        g[2, 2], g[4, 2], g[5, 2] = 1.0, 2 * b, a
        for o in range(orders):
            x, y, z = g[o]
            if not sloped and x == 0.0:
                continue
            for q in range(4):
                of, force = x * w[q], x * by[q] * u / 2
                across, along = y * w[q], z * w[q]
                for j in range(taxels):
                    term = terms[o, p, k + q, j]
                    out[0, f, j] += of * term
                    if sloped:
                        out[1, f, j] += across * term
                        out[2, f, j] += along * term
                        out[3, f, j] += force * term
    return out
