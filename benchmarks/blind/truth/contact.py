"""Pressure under a rigid sphere on the finger, for two laws of contact, as fields round the contact point.

Both laws are linear in the stiffness E, so a field is kept for E = 1 Pa/m and depends on the force over E only. The
finger is the same all along, so it does not depend on the place either.

* :class:`Foundation`: the pressure at a point follows from the penetration of the same point (a Winkler foundation),
  summed over fine cells; the depth that carries a force is bisected.
* :class:`Layer`: an elastic layer on a rigid core gives way beside the place that is pressed, too. Its surface moves by
  an influence matrix times the pressures of the cells; which cells touch is found by an active set. The influence of
  a cell at the distance r is that of a disc of the same area, by a Hankel transform of the layer's compliance

      u(r) = (a integral of G(k) J0(k r) J1(k a) dk),

  G for an isotropic layer bonded to its core (Johnson, Contact Mechanics, 1985, section 5.5), and optionally a thin
  coat on it that is a foundation of its own.

What a taxel feels of a pressure is its part along the contact normal, times the cosine of the sphere's normal.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import j0, j1

from benchmarks.blind.truth.rig import FINGER_RADIUS_M, Floats

SPACING_M = 0.1e-3
"""Of the cells of a field."""
SIDE = 160
"""Cells of a field in each direction: 16 mm, so that what is smeared over a taxel does not reach round its ends."""

_COARSE_M, _COARSE_HALF = 0.2e-3, 24
_LEVELS, _BISECTIONS = 40, 48
_DEEPEST_M = 3.8e-3
_DEPTHS, _MORE = 28, 1.1
"""A layer is solved for as many depths up to that of a foundation, and on in the same steps times the latter."""


def axis_m() -> Floats:
    """Centres of a field's cells from the contact point, in either direction (SIDE,) [m]."""
    return (np.arange(float(SIDE)) - SIDE / 2 + 0.5) * SPACING_M


@dataclass(frozen=True)
class Hardening:
    """A skin whose stress grows faster than in proportion: ``exp`` of the penetration over ``depth_m`` (Fung).

    A negative depth is a skin that gives way.
    """

    depth_m: float

    def factor(self, penetration_m: Floats) -> Floats:
        """Stress over that of the linear law."""
        ratio = np.clip(penetration_m / self.depth_m, -30.0, 5.0)
        small = np.abs(ratio) < 1e-6
        return np.where(small, 1.0, np.expm1(ratio) / np.where(small, 1.0, ratio))


@dataclass(frozen=True, eq=False)
class Geometry:
    """Sphere over finger on a grid of cells: gap at first touch [m], and the two cosines."""

    gap_m: Floats
    along_normal: Floats
    facing: Floats

    @classmethod
    def of(cls, sphere_m: float, arc_m: Floats, along_m: Floats) -> Geometry:
        """At places round and along the finger from the contact point [m], of any one shape."""
        angle = arc_m / FINGER_RADIUS_M
        square = sphere_m**2 - (FINGER_RADIUS_M * np.sin(angle)) ** 2 - along_m**2
        height = np.sqrt(np.maximum(square, 0.0))
        gap = FINGER_RADIUS_M * (1 - np.cos(angle)) + sphere_m - height
        return cls(np.where(square > 0, gap, np.inf), np.maximum(np.cos(angle), 0.0), height / sphere_m)


@dataclass(frozen=True, eq=False)
class Fields:
    """Pressures for E = 1 Pa/m.

    Attributes:
        root: (n,) sqrt of force over E, rising from zero [sqrt(m³)].
        felt: (n, SIDE, SIDE) what a taxel sums up, over E [m].
        depth_m: (n,) how far the sphere has come since first touch [m].
    """

    root: Floats
    felt: Floats
    depth_m: Floats

    def stiffened(self, factor: float) -> Fields:
        """Return the fields of a law that is stiffer by a factor."""
        return Fields(np.sqrt(factor) * self.root, factor * self.felt, self.depth_m)


@dataclass(frozen=True)
class Foundation:
    """See the module."""

    name = "linear foundation"

    def depths_m(self, sphere_m: float, force_m3: Floats, hardening: Hardening | None) -> Floats:
        """Return the sphere's penetration (n,) [m] under forces over E (n,) [m³]."""
        return self._solved(_whole(sphere_m), force_m3, hardening)

    def fields(self, sphere_m: float, largest_m3: float, hardening: Hardening | None) -> Fields:
        """Fields up to a force over E [m³]."""
        geometry = _whole(sphere_m)
        root = np.linspace(0.0, np.sqrt(largest_m3), _LEVELS)
        depth = self._solved(geometry, root**2, hardening)
        near = geometry.gap_m < depth[-1]
        felt = np.zeros((len(root), SIDE, SIDE))
        part = (geometry.along_normal * geometry.facing)[near]
        felt[:, near] = _pressure(depth[:, None] - geometry.gap_m[near], hardening) * part
        return Fields(root, felt, depth)

    @staticmethod
    def _solved(geometry: Geometry, force_m3: Floats, hardening: Hardening | None) -> Floats:
        near = geometry.gap_m < _DEEPEST_M
        gap, weight = geometry.gap_m[near], geometry.along_normal[near] * SPACING_M**2
        low, high = np.zeros(len(force_m3)), np.full(len(force_m3), _DEEPEST_M)
        for _ in range(_BISECTIONS):
            middle = (low + high) / 2
            enough = _pressure(middle[:, None] - gap, hardening) @ weight >= force_m3
            high, low = np.where(enough, middle, high), np.where(enough, low, middle)
        return high


def _whole(sphere_m: float) -> Geometry:
    """On the cells of a field."""
    return Geometry.of(sphere_m, *np.meshgrid(axis_m(), axis_m(), indexing="ij"))


def _pressure(penetration_m: Floats, hardening: Hardening | None) -> Floats:
    pressed = np.maximum(penetration_m, 0.0)
    return pressed if hardening is None else pressed * hardening.factor(pressed)


@dataclass(frozen=True)
class Layer:
    """See the module.

    Attributes:
        thickness_m: of the layer [m].
        poisson: Poisson's ratio of the layer.
        coat: part of the compliance under even pressure that a coat has, in [0, 1).
    """

    thickness_m: float
    poisson: float
    coat: float = 0.0
    name = "elastic layer"

    def compliance(self, wave_per_m: Floats) -> Floats:
        """G(k) for E = 1 Pa/m, E being the stiffness under even pressure."""
        nu, x = self.poisson, np.minimum(wave_per_m * self.thickness_m, 200.0)
        # Over exp(2 x), so that nothing overflows.
        fall = np.exp(-2 * x)
        above = (3 - 4 * nu) * (1 - fall**2) / 2 - 2 * x * fall
        below = (3 - 4 * nu) * (1 + fall**2) / 2 + (2 * x**2 + 5 - 12 * nu + 8 * nu**2) * fall
        small = x < 1e-6
        # h / M = 1, so mu = h (1 - 2 nu) / (2 (1 - nu)).
        shape = 2 * (1 - nu) ** 2 / (1 - 2 * nu) * above / below / np.where(small, 1.0, x)
        return (1 - self.coat) * np.where(small, 1.0, shape)

    @cached_property
    def _influence(self) -> Floats:
        """(n, n) displacement of a cell of one quadrant under unit pressure on a cell and its three mirror images."""
        centre = (np.arange(float(_COARSE_HALF)) + 0.5) * _COARSE_M
        s, t = (a.ravel() for a in np.meshgrid(centre, centre, indexing="ij"))
        total = np.zeros((len(s), len(s)))
        radius = np.linspace(0.0, 2.9 * _COARSE_HALF * _COARSE_M, 900)
        table = self._disc(radius)
        for sign_s in (1, -1):
            for sign_t in (1, -1):
                distance = np.hypot(s[:, None] - sign_s * s, t[:, None] - sign_t * t)
                total += np.interp(distance, radius, table)
        total[np.diag_indices_from(total)] += self.coat
        return total

    def _disc(self, radius_m: Floats) -> Floats:
        disc = _COARSE_M / np.sqrt(np.pi)
        k = np.linspace(0.0, 60.0 / disc, 24001)[1:]
        # The oscillating tail is faded out, not cut off.
        fade = np.exp(-((k * disc / 30.0) ** 4))
        weight = self.compliance(k) * j1(k * disc) * fade * disc * (k[1] - k[0])
        return np.array([float(weight @ j0(k * r)) for r in radius_m])

    def fields(self, sphere_m: float, largest_m3: float, hardening: Hardening | None) -> Fields:
        """Fields up to a force over E [m³], or to the deepest that is solved for."""
        centre = (np.arange(float(_COARSE_HALF)) + 0.5) * _COARSE_M
        s, t = (a.ravel() for a in np.meshgrid(centre, centre, indexing="ij"))
        geometry = Geometry.of(sphere_m, s, t)
        weight = 4 * _COARSE_M**2 * geometry.along_normal
        depths, carried, felt = [0.0], [0.0], [np.zeros((SIDE, SIDE))]
        step = _MORE * float(Foundation().depths_m(sphere_m, np.array([largest_m3]), None)[0]) / _DEPTHS
        for depth in np.arange(step, _DEEPEST_M, step):
            pressure = self._touching(depth - geometry.gap_m)
            if hardening is not None:
                pressure = pressure * hardening.factor(np.maximum(depth - geometry.gap_m, 0.0))
            depths.append(float(depth))
            carried.append(float(pressure @ weight))
            felt.append(_unfolded(pressure * geometry.along_normal * geometry.facing))
            if carried[-1] > largest_m3:
                break
        return Fields(np.sqrt(np.array(carried)), np.array(felt), np.array(depths))

    def _touching(self, overlap_m: Floats) -> Floats:
        """Pressures, nowhere negative, under which touching cells move by their overlap and others by more."""
        touch = overlap_m > 0
        pressure = np.zeros_like(overlap_m)
        for _ in range(60):
            pressure[:] = 0.0
            pressure[touch] = np.linalg.solve(self._influence[np.ix_(touch, touch)], overlap_m[touch])
            pulled = touch & (pressure < 0)
            if pulled.any():
                touch = touch & ~pulled
                continue
            through = ~touch & np.isfinite(overlap_m) & (self._influence @ pressure < overlap_m - 1e-12)
            if not through.any():
                return pressure
            touch = touch | through
        return np.maximum(pressure, 0.0)


def _unfolded(quadrant: Floats) -> Floats:
    """A field on the fine cells, from the values of one quadrant's coarse cells."""
    fine = round(_COARSE_M / SPACING_M)
    part = quadrant.reshape(_COARSE_HALF, _COARSE_HALF).repeat(fine, axis=0).repeat(fine, axis=1)
    whole = np.zeros((SIDE, SIDE))
    middle, reach = SIDE // 2, len(part)
    whole[middle : middle + reach, middle : middle + reach] = part
    half = whole + whole[::-1]
    return half + half[:, ::-1]
