"""Loads of the taxels from fields of pressure: each field smeared over a taxel once, then only looked up.

A taxel's load is the integral of the field over a square turned by alpha. In Fourier space that is a product with two
sinc functions, so what comes out is exact for the field on its cells.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import fft
from scipy.interpolate import CubicSpline
from scipy.ndimage import map_coordinates, spline_filter

from benchmarks.blind.truth.contact import SIDE, SPACING_M, Fields, Foundation, Hardening, Layer
from benchmarks.blind.truth.half_space import HalfSpace
from benchmarks.blind.truth.rig import SPHERES_M, TAXEL_M, Floats

_LEVELS = 40


@dataclass(frozen=True)
class ContactKind:
    """Key of a field, besides the law and the force.

    Attributes:
        sphere_m: radius of the indenter [m].
        hardening: of the skin; None for a linear one.
        sheet_m: length over which a cover with shear stiffness spreads pressure [m]; zero without one.
    """

    sphere_m: float
    hardening: Hardening | None = None
    sheet_m: float = 0.0


@dataclass(frozen=True, eq=False)
class Images:
    """Loads of squares in a field, by force and place.

    Attributes:
        fields: pressures.
        alpha_deg: turn of the taxels [°].
        sheet_m: see :class:`ContactKind`.
    """

    fields: Fields
    alpha_deg: float
    sheet_m: float = 0.0

    @cached_property
    def _table(self) -> tuple[float, Floats]:
        """Step of sqrt(force over E), and the spline's coefficients (levels, SIDE, SIDE)."""
        loads = fft.irfft2(fft.rfft2(self.fields.felt) * self._smear(), s=(SIDE, SIDE))
        root = np.linspace(0.0, self.fields.root[-1], _LEVELS)
        if not np.allclose(root, self.fields.root if len(self.fields.root) == _LEVELS else 0.0):
            loads = CubicSpline(self.fields.root, loads, axis=0)(root)
        return float(root[1]), spline_filter(loads, order=3, mode="mirror")

    def _smear(self) -> Floats:
        ks = 2 * np.pi * fft.fftfreq(SIDE, SPACING_M)[:, None]
        kt = 2 * np.pi * fft.rfftfreq(SIDE, SPACING_M)[None, :]
        turn = np.radians(self.alpha_deg)
        ku, kv = ks * np.cos(turn) + kt * np.sin(turn), -ks * np.sin(turn) + kt * np.cos(turn)
        half = TAXEL_M / (2 * np.pi)
        square = TAXEL_M**2 * np.sinc(ku * half) * np.sinc(kv * half)
        return square / (1 + self.sheet_m**2 * (ks**2 + kt**2))

    def loads(self, force_m3: Floats, arc_m: Floats, along_m: Floats) -> Floats:
        """Loads over E [m³] of squares at places from the contact point [m], with forces over E [m³], any shape."""
        step, coefficients = self._table
        shape = np.broadcast_shapes(force_m3.shape, arc_m.shape, along_m.shape)
        level = np.broadcast_to(np.sqrt(np.maximum(force_m3, 0.0)) / step, shape)
        places = [np.broadcast_to(a / SPACING_M + SIDE / 2 - 0.5, shape) for a in (arc_m, along_m)]
        found = np.zeros(shape)
        near = (level > 0) & (np.abs(arc_m) < 7.5e-3) & (np.abs(along_m) < 7.5e-3)
        where = [np.minimum(level[near], _LEVELS - 1.0), *(p[near] for p in places)]
        found[near] = map_coordinates(coefficients, where, order=3, mode="mirror", prefilter=False)
        return np.maximum(found, 0.0)


Law = Foundation | Layer | HalfSpace


class ImageStore:
    """Fields and images of one contact law, made when they are asked for and kept.

    Args:
        law: of the contact.
        largest_m3: the largest force over E that is asked for [m³].
        alike_m3: a force over E at which the larger sphere shall sink in as far as into a foundation [m³]: the law is
            made stiffer by what it takes, so that E is that of an equivalent foundation. None leaves it as it is.
    """

    def __init__(self, law: Law, largest_m3: float, alike_m3: float | None = None) -> None:
        self.law, self._largest = law, largest_m3
        self.stiffer = 1.0 if alike_m3 is None else _stiffness_ratio(law, alike_m3)
        self._fields: dict[tuple[float, Hardening | None], Fields] = {}
        self._images: dict[tuple[ContactKind, float], Images] = {}

    def fields(self, kind: ContactKind) -> Fields:
        """Pressures of a kind of contact."""
        key = (kind.sphere_m, kind.hardening)
        if key not in self._fields:
            self._fields[key] = self.law.fields(
                kind.sphere_m, self._largest / self.stiffer, kind.hardening
            ).stiffened(self.stiffer)
        return self._fields[key]

    def images(self, kind: ContactKind, alpha_deg: float) -> Images:
        """Images of a kind of contact on taxels with a turn."""
        key = (kind, alpha_deg)
        if key not in self._images:
            self._images[key] = Images(self.fields(kind), alpha_deg, kind.sheet_m)
        return self._images[key]


def _stiffness_ratio(law: Law, force_m3: float) -> float:
    """Stiffness of a foundation over that of a law, at the depth to which the foundation gives way."""
    depth = Foundation().depths_m(SPHERES_M[0], np.array([force_m3]), None)[0]
    # A law that is much stiffer is not solved for far deeper than it is needed.
    fields = law.fields(SPHERES_M[0], 2 * force_m3, None)
    while fields.depth_m[-1] < depth:
        fields = law.fields(SPHERES_M[0], 2 * float(fields.root[-1]) ** 2, None)
    return force_m3 / float(np.interp(depth, fields.depth_m, fields.root)) ** 2
