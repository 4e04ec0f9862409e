"""A rigid sphere pressed into an elastic layer that is bonded to a rigid cylinder.

The skin model is an elastic foundation: stress follows from the penetration of the same point. A real skin is a
layer of rubber on a hard core, which also gives way beside the place that is pressed. This solver is that layer, so
that fits can be judged on images whose contact law is not their own.

The layer is flat for its elasticity (its curvature is small over a contact) and curved for the gap. Its surface moves
by ``u = K p``; K is a product in Fourier space (compliance of a bonded layer, e.g. Johnson, Contact Mechanics, 1985,
chapter 5.5; frictionless)::

    G(k) = (1-nu) / (mu k) * [(3-4nu) sinh 2x - 2x] / [(3-4nu) cosh 2x + 2x^2 + 5 - 12nu + 8nu^2],   x = k h

It tends to that of a foundation, ``h/M`` with ``M = 2 mu (1-nu) / (1-2nu)``, for waves much longer than the layer
is thick, and to that of a half-space for short ones. The pressure, nowhere negative, is found by conjugate gradients
(Polonsky & Keer 1999).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.ndimage import map_coordinates
from scipy.optimize import brentq

from skincal.model import StressLaw

Floats = NDArray[np.float64]

MAX_STEPS = 1000


class ContactError(RuntimeError):
    """The contact could not be found: no convergence, or it reaches the border of the grid."""


class SmallContactError(ContactError):
    """The contact is too small for the cells of the grid."""


@dataclass(frozen=True)
class Layer:
    """An elastic layer, bonded to a rigid core.

    Attributes:
        thickness_m: h [m].
        shear_modulus_pa: mu [Pa].
        poisson: nu, in [0, 0.5).
    """

    thickness_m: float
    shear_modulus_pa: float
    poisson: float

    @classmethod
    def of_stiffness(cls, elasticity_pa_per_m: float, thickness_m: float, poisson: float) -> Layer:
        """The layer whose stiffness under even pressure, M/h, is ``elasticity_pa_per_m`` [Pa/m]."""
        constrained = elasticity_pa_per_m * thickness_m
        return cls(thickness_m, constrained * (1 - 2 * poisson) / (2 * (1 - poisson)), poisson)

    @property
    def elasticity_pa_per_m(self) -> float:
        """M/h: pressure per penetration where the pressure is even [Pa/m]."""
        nu = self.poisson
        return 2 * self.shear_modulus_pa * (1 - nu) / (1 - 2 * nu) / self.thickness_m

    def compliance(self, wavenumber: Floats) -> Floats:
        """G(k) [m/Pa] for wavenumbers of any shape [rad/m], 0 included."""
        nu, k = self.poisson, np.asarray(wavenumber, dtype=np.float64)
        x = k * self.thickness_m
        # Numerator and denominator both times 2 exp(-2x), so that nothing overflows.
        fade = np.exp(-2 * x)
        above = -(3 - 4 * nu) * np.expm1(-4 * x) - 4 * x * fade
        below = (3 - 4 * nu) * (1 + fade**2) + 2 * fade * (2 * x**2 + 5 - 12 * nu + 8 * nu**2)
        safe = np.where(x > 1e-6, k, 1.0)
        short = (1 - nu) / (self.shear_modulus_pa * safe) * above / below
        return np.where(x > 1e-6, short, 1.0 / self.elasticity_pa_per_m)


@dataclass(frozen=True, eq=False)
class ContactProblem:
    """A layer and a gap over it, on a square grid of cells.

    Attributes:
        layer: what is pressed.
        gap_m: (n, n) distance of the surfaces at first touch [m]; inf where they never meet.
        spacing_m: edge length of a cell [m].
        settled: contact is found when its surfaces part by less than this, relative to the approach, everywhere.
    """

    layer: Layer
    gap_m: Floats
    spacing_m: float
    settled: float

    @cached_property
    def _response(self) -> Floats:
        """G on the grid twice as large: pressure does not reach round its ends."""
        size = 2 * len(self.gap_m)
        k = 2 * np.pi * fft.fftfreq(size, self.spacing_m)
        return self.layer.compliance(np.hypot(k[:, None], k[None, : size // 2 + 1]))

    def displacement(self, pressure_pa: Floats) -> Floats:
        """Displacement of the surface (n, n) [m] under a pressure (n, n) [Pa]."""
        n = len(pressure_pa)
        spectrum = fft.rfft2(pressure_pa, s=(2 * n, 2 * n))
        return fft.irfft2(spectrum * self._response, s=(2 * n, 2 * n))[:n, :n]

    def solve(self, load_n: float, start: Floats | None = None) -> tuple[Floats, float]:
        """Pressure under a load normal to the layer.

        Args:
            load_n: sum of pressure times area [N].
            start: (n, n) pressure to start from; None for an even one.

        Returns:
            Pressure (n, n) [Pa], and the approach [m]: displacement plus gap where they touch.

        Raises:
            ContactError: no convergence, or contact at the border of the grid.
        """
        mean = load_n / self.spacing_m**2
        reach = np.isfinite(self.gap_m)
        gap = np.where(reach, self.gap_m, 0.0)
        p = np.where(reach, 1.0, 0.0) if start is None else start
        p = p * (mean / p.sum())
        step, before, restart = np.zeros_like(p), 1.0, True
        for _ in range(MAX_STEPS):
            touch = p > 0
            apart = self.displacement(p) + gap
            approach = float(apart[touch].mean())
            apart -= approach
            squares = float((apart[touch] ** 2).sum())
            step = np.where(touch, apart + (0.0 if restart else squares / before) * step, 0.0)
            moved = self.displacement(step)
            moved -= moved[touch].mean()
            curve = float((moved[touch] * step[touch]).sum())
            if not curve > 0:
                if touch.mean() < 0.5:
                    raise SmallContactError("the contact is smaller than two cells")
                raise ContactError("the contact fills the grid")
            length = float((apart[touch] * step[touch]).sum()) / curve
            overlap = reach & ~touch & (apart < 0)
            worst = max(float(np.abs(apart[touch]).max()), -float(apart[overlap].min(initial=0.0)))
            if worst < self.settled * abs(approach):
                self._check_inside(p)
                return p, approach
            p = np.maximum(p - length * step, 0.0)
            overlap &= p <= 0
            p[overlap] -= length * apart[overlap]
            restart, before = bool(overlap.any()), squares
            p *= mean / p.sum()
        raise ContactError(f"the contact did not settle in {MAX_STEPS} steps")

    @staticmethod
    def _check_inside(p: Floats) -> None:
        if p[[0, -1]].any() or p[:, [0, -1]].any():
            raise ContactError("the contact reaches the border of the grid; make the grid larger")


@dataclass(frozen=True)
class Press:
    """A sphere on a cylinder, on a grid of cells centred on the contact.

    Attributes:
        cylinder_radius_m: of the layer's surface at rest [m]; inf for a plane.
        sphere_radius_m: of the indenter [m].
        spacing_m: edge length of a cell [m].
        half_width_m: how far the grid reaches on each side [m].
        settled: how nearly the contact is found, relative to the approach; the force ten times that.
    """

    cylinder_radius_m: float
    sphere_radius_m: float
    spacing_m: float = 0.1e-3
    half_width_m: float = 5.6e-3
    settled: float = 1e-6

    @property
    def axis_m(self) -> Floats:
        """(n,) centres of the cells along either direction, from the contact point [m]."""
        half = round(self.half_width_m / self.spacing_m)
        return (np.arange(2 * half, dtype=np.float64) - half + 0.5) * self.spacing_m

    @cached_property
    def _geometry(self) -> tuple[Floats, Floats, Floats]:
        """Gap along the contact normal [m], and cosines of the surface's and the sphere's normal to it, (n, n) each."""
        arc, along = np.meshgrid(self.axis_m, self.axis_m, indexing="ij")
        if np.isinf(self.cylinder_radius_m):
            sideways, depth, cosine = arc, np.zeros_like(arc), np.ones_like(arc)
        else:
            turn = arc / self.cylinder_radius_m
            sideways = self.cylinder_radius_m * np.sin(turn)
            depth, cosine = self.cylinder_radius_m * (1 - np.cos(turn)), np.cos(turn)
        left = self.sphere_radius_m**2 - sideways**2 - along**2
        height = np.sqrt(np.maximum(left, 0.0))
        gap = np.where(left > 0, depth + self.sphere_radius_m - height, np.inf)
        return gap, np.maximum(cosine, 0.0), height / self.sphere_radius_m

    @property
    def gap_m(self) -> Floats:
        """(n, n) distance of sphere and surface at first touch, along the contact normal [m]."""
        return self._geometry[0]

    def foundation_pa(
        self, elasticity_pa_per_m: float, force_n: float, law: StressLaw | None = None
    ) -> Floats:
        """Compute the stress (n, n) [Pa] that a taxel feels on an elastic foundation; linear without a law."""
        law = law or StressLaw(1.0, 1.0)
        gap, cosine, facing = self._geometry
        near = np.where(np.isfinite(gap), gap, self.sphere_radius_m)

        def pressure(depth_m: float) -> Floats:
            depth = np.maximum(depth_m - near, 0.0)
            return elasticity_pa_per_m * law.reference_m * (depth / law.reference_m) ** law.exponent

        def missing(depth_m: float) -> float:
            return float((pressure(depth_m) * cosine).sum()) * self.spacing_m**2 - force_n

        deepest = self.sphere_radius_m
        depth = deepest if missing(deepest) < 0 else float(brentq(missing, 0.0, deepest))
        return pressure(depth) * cosine * facing

    def fields(self, layer: Layer, force_n: Floats) -> list[PressureField]:
        """Contacts at some forces (K,) along the contact normal [N]."""
        problem = ContactProblem(layer, self.gap_m, self.spacing_m, self.settled)
        order = np.argsort(force_n)
        found: list[PressureField] = []
        for force in force_n[order]:
            # Grown from the next smaller one, the pressure settles sooner.
            found.append(self._field(problem, float(force), found[-1] if found else None))
        return [found[rank] for rank in np.argsort(order)]

    def _field(self, problem: ContactProblem, force_n: float, near: PressureField | None) -> PressureField:
        _, cosine, facing = self._geometry
        area = self.spacing_m**2
        pressure, load = None, force_n
        if near is not None:
            pressure, load = near.pressure_pa, near.load_n / near.force_n * force_n
        while True:
            # The load on the curved surface is a little more than the force along the normal.
            pressure, approach = problem.solve(load, pressure)
            carried = float((pressure * cosine).sum()) * area
            if abs(carried / force_n - 1) < 10 * self.settled:
                felt = pressure * cosine * facing
                return PressureField(self.axis_m, pressure, approach, load, carried, felt)
            load *= force_n / carried


@dataclass(frozen=True, eq=False)
class PressureField:
    """Pressures of a press, on the grid of :class:`Press`."""

    axis_m: Floats
    pressure_pa: Floats
    approach_m: float
    load_n: float
    force_n: float
    felt_pa: Floats

    def felt_at(self, arc_m: Floats, along_m: Floats, bare: float = 0.0) -> Floats:
        """``felt_pa`` at places of any shape, relative to the contact point [m]; linear between cells.

        ``bare`` is the part of the pressure itself in it.
        """
        spacing = self.axis_m[1] - self.axis_m[0]
        rows = [(at - self.axis_m[0]) / spacing for at in (arc_m, along_m)]
        felt = (1 - bare) * self.felt_pa + bare * self.pressure_pa
        return map_coordinates(felt, rows, order=1, mode="constant")
