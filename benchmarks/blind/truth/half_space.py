"""A half space under a rigid sphere, solved by the published package ContactMechanics (`pip install ContactMechanics`).

A skin far thicker than the contact is wide: force per unit area of a free elastic half space by its FFT solver
(Stanley and Kato, J. Tribol. 119 (1997) 481), a contact law that neither skincal nor the elastic layers of the other
sessions have. The finger's curvature is in the gap, not in the compliance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from benchmarks.blind.truth.contact import SIDE, SPACING_M, Fields, Geometry, Hardening

_COARSE = 2
"""Cells of a field in one of the solver, in each direction."""
_STEPS = 20
"""Depths up to that of a flat half space; the finger's curvature asks for a few more."""
_FAR_M = 0.02
"""Gap where the sphere does not reach."""


@dataclass(frozen=True)
class HalfSpace:
    """Elastic half space; its modulus is E times a depth, which the equivalent stiffness replaces.

    Attributes:
        depth_m: depth whose layer under even pressure would be as stiff [m].
    """

    depth_m: float = 5e-3
    name = "half space"

    def fields(self, sphere_m: float, largest_m3: float, hardening: Hardening | None) -> Fields:
        """Fields up to a force over E [m³].

        Raises:
            RuntimeError: the solver did not converge.
        """
        import ContactMechanics  # an optional package
        from SurfaceTopography import Topography

        cells, size = SIDE // _COARSE, SPACING_M * _COARSE
        axis = (np.arange(float(cells)) - cells / 2 + 0.5) * size
        geometry = Geometry.of(sphere_m, *np.meshgrid(axis, axis, indexing="ij"))
        gap = np.minimum(geometry.gap_m, _FAR_M)
        sides = (cells * size,) * 2
        half_space = ContactMechanics.FreeFFTElasticHalfSpace((cells, cells), self.depth_m, sides)
        system = ContactMechanics.make_system(substrate=half_space, surface=Topography(-gap, sides))
        step = self._flat_depth_m(sphere_m, largest_m3) / _STEPS
        depths, carried, felt = [0.0], [0.0], [np.zeros((SIDE, SIDE))]
        while carried[-1] <= largest_m3:
            depths.append(depths[-1] + step)
            if not system.minimize_proxy(offset=depths[-1], pentol=1e-8).success:
                raise RuntimeError(f"ContactMechanics did not converge at a depth of {depths[-1]:.3g} m")
            pressure = np.asarray(system.force) / size**2
            if hardening is not None:
                pressure = pressure * hardening.factor(np.maximum(depths[-1] - gap, 0.0))
            pressure = pressure * geometry.along_normal
            carried.append(float(pressure.sum()) * size**2)
            felt.append((pressure * geometry.facing).repeat(_COARSE, axis=0).repeat(_COARSE, axis=1))
        return Fields(np.sqrt(np.array(carried)), np.array(felt), np.array(depths))

    def _flat_depth_m(self, sphere_m: float, force_m3: float) -> float:
        """Depth of the sphere on a flat half space under a force over E (Hertz) [m]."""
        return float((0.75 * force_m3 / (self.depth_m * np.sqrt(sphere_m))) ** (2 / 3))
