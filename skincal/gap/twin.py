"""Twins: the same sensor under a contact law that is not the fitted one, so that the law's own error is not named.

Where the surface is a cylinder or a plane and all indenters are spheres, the twin is an elastic layer
(:mod:`skincal.gap.elastic_layer`), whose pressure about a contact is the same wherever it is pressed: it is tabled over
the force once. For other shapes the twin is the foundation with a stress that grows as another power of the
penetration.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from math import ceil, exp, log

import numpy as np
from scipy.ndimage import map_coordinates

from skincal.effects import Samples
from skincal.gap.elastic_layer import ContactError, Layer, Press
from skincal.gap.hypothesis import Hypothesis
from skincal.gap.session import GapSession
from skincal.model import Cylinder, Indenter, Plane, Sphere
from skincal.model.arrays import FloatArray, as_floats

THICKNESSES_M = (1.0e-3, 2.5e-3, 5.0e-3)
"""Layers of these thicknesses are the twins [m]."""
POWERS = (0.85, 1.2)
"""Exponents of the stress where there is no layer."""
_POISSON = 0.4
_SPACING_M, _HALF_WIDTH_M = 0.25e-3, 6e-3
_FORCES = 14
_LEAST_FORCE = 0.01
"""The smallest force of the table, in parts of the largest."""


@dataclass(frozen=True)
class Twin:
    """A law, and what observations (N, J) [counts] of a session it gives for a sensor."""

    name: str
    values: Callable[[Hypothesis, GapSession], FloatArray]


def twins_for(hypothesis: Hypothesis, session: GapSession) -> tuple[Twin, ...]:
    """Laws other than the fitted one that can be computed for this sensor and these indenters."""
    balls = all(isinstance(indenter, Sphere) for indenter in session.samples.indenters)
    if balls and isinstance(hypothesis.model.surface, Cylinder | Plane):
        return tuple(_layer(h) for h in THICKNESSES_M)
    return tuple(_power(n) for n in POWERS)


def _power(exponent: float) -> Twin:
    def values(hypothesis: Hypothesis, session: GapSession) -> FloatArray:
        law = {"stiffening": {"exponent": np.asarray(exponent)}}
        return hypothesis.with_effects(law).values(session)

    return Twin(f"power {exponent:g}", values)


def _layer(thickness_m: float) -> Twin:
    def values(hypothesis: Hypothesis, session: GapSession) -> FloatArray:
        placed = hypothesis.placed(session).samples
        return session.means(layer_loads(hypothesis, placed, thickness_m) * hypothesis.model.scale_per_n)

    return Twin(f"layer {1e3 * thickness_m:g} mm", values)


def layer_loads(hypothesis: Hypothesis, samples: Samples, thickness_m: float) -> FloatArray:
    """Loads (K, J) of taxels under an elastic layer [N], of the stiffness under even pressure that E says."""
    patch = hypothesis.skin.skin.patch
    loads = np.zeros((len(samples), patch.layout.taxels))
    felt = patch.taxel >= 0
    points, areas, taxel = patch.points_m[felt], patch.areas_m2[felt], patch.taxel[felt]
    surface = hypothesis.model.surface
    arc, along = _unrolled(points, surface)
    reach = samples.touching & (samples.contacts.force_n > 0)
    reach &= np.isfinite(samples.contacts.points_m).all(axis=1)
    for number, indenter in enumerate(samples.indenters):
        rows = np.flatnonzero(reach & (samples.indenter == number))
        if not len(rows):
            continue
        force = samples.contacts.force_n[rows]
        table = _table(
            indenter, surface, hypothesis.model.elasticity_pa_per_m, thickness_m, float(force.max())
        )
        at = _unrolled(surface.project(samples.contacts.points_m[rows]), surface)
        stress = table.at(force, arc - at[0][:, None], along - at[1][:, None])
        owner = np.zeros((len(taxel), loads.shape[1]))
        owner[np.arange(len(taxel)), taxel] = areas
        loads[rows] = stress @ owner
    return loads


def _unrolled(points_m: FloatArray, surface: object) -> tuple[FloatArray, FloatArray]:
    """Arc and place along the axis (n,) of points (n, 3) on the surface [m]."""
    if isinstance(surface, Cylinder):
        return surface.radius_m * np.arctan2(points_m[:, 0], points_m[:, 2]), points_m[:, 1]
    return points_m[:, 0], points_m[:, 1]


@dataclass(frozen=True, eq=False)
class _Table:
    """What taxels feel (F, n, n) [Pa] about a contact, over the logarithm of the force."""

    felt_pa: FloatArray
    log_force: FloatArray
    first_m: float

    def at(self, force_n: FloatArray, arc_m: FloatArray, along_m: FloatArray) -> FloatArray:
        """(k, points) for forces (k,) and distances (k, points), linear between."""
        steps = len(self.log_force) - 1
        level: FloatArray = (
            (np.log(force_n) - self.log_force[0]) / (self.log_force[-1] - self.log_force[0]) * steps
        )
        # Below the table a contact of nearly no size: its pressure shrinks with the force.
        least = float(np.exp(self.log_force[0]))
        weak: FloatArray = np.minimum(force_n, least) / least
        rows = np.broadcast_to(np.clip(level, 0.0, float(steps))[:, None], arc_m.shape)
        spot = [(x - self.first_m) / _SPACING_M for x in (arc_m, along_m)]
        found = as_floats(map_coordinates(self.felt_pa, [rows, *spot], order=1, mode="constant"))
        return found * weak[:, None]


def _table(
    indenter: Indenter, surface: object, elasticity_pa_per_m: float, thickness_m: float, most_n: float
) -> _Table:
    assert isinstance(indenter, Sphere)
    radius = surface.radius_m if isinstance(surface, Cylinder) else float("inf")
    # Rounded, so that small moves of a fit do not ask for another table.
    stiffness = exp(round(log(elasticity_pa_per_m), 2))
    force = exp(ceil(10 * log(most_n)) / 10)
    return _solved(indenter.radius_m, radius, stiffness, thickness_m, force)


@cache
def _solved(
    sphere_m: float, cylinder_m: float, elasticity_pa_per_m: float, thickness_m: float, most_n: float
) -> _Table:
    layer = Layer.of_stiffness(elasticity_pa_per_m, thickness_m, _POISSON)
    forces = np.geomspace(_LEAST_FORCE * most_n, most_n, _FORCES)
    half = min(_HALF_WIDTH_M, 0.98 * sphere_m)
    while True:
        press = Press(cylinder_m, sphere_m, _SPACING_M, half)
        try:
            fields = press.fields(layer, forces)
        except ContactError:
            # A soft layer: the ball sinks in beyond the grid. Twice as stiff is as good a twin.
            layer = Layer.of_stiffness(2 * layer.elasticity_pa_per_m, thickness_m, _POISSON)
            continue
        felt = np.stack([f.felt_pa for f in fields])
        return _Table(felt, np.log(forces), float(press.axis_m[0]))
