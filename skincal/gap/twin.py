"""Twins: sensors under a contact law that is not the fitted one, so that the law's own error is not named.

Where the surface is a cylinder or a plane and all indenters are spheres, the twins are elastic layers
(:mod:`skincal.inference.elastic_layer`), whose pressure about a contact is the same wherever it is pressed: it is tabled over
the force once. A layer has the stiffness that spreads the pressure of a press of middling force as far as the fitted
foundation does, which is where the search for the one that the fitted sensor fits begins
(:func:`skincal.gap.null.law_errors`). For other shapes the twin is the foundation with a
stress that grows as another power of the penetration.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from math import ceil, exp, log, sqrt

import numpy as np
from scipy.ndimage import map_coordinates

from skincal.effects import Samples
from skincal.inference.elastic_layer import ContactError, Layer, Press, SmallContactError
from skincal.gap.hypothesis import Hypothesis
from skincal.inference.session import GapSession
from skincal.model import Cylinder, Indenter, Plane, Sphere, Surface
from skincal.model.arrays import FloatArray, as_floats

THICKNESSES_M = (1.0e-3, 1.8e-3, 3.0e-3, 5.0e-3, 10.0e-3)
"""Layers of these thicknesses are the twins [m]."""
POWERS = (0.85, 1.2)
"""Exponents of the stress where there is no layer."""
_POISSON = 0.4
_SPACING_M, _HALF_WIDTH_M = 0.25e-3, 6e-3
_FORCES = 14
_LEAST_FORCE = 0.01
"""The smallest force of the table, in parts of the largest."""
_ALIKE, _TRIES = 0.01, 16
"""Widths of pressures differ by so much at most, relative; halving and doubling get there in a few steps."""


@dataclass(frozen=True)
class Twin:
    """A law, and what observations (N, J) [counts] of a session it gives for a sensor, whatever its pose, E and S."""

    name: str
    values: Callable[[Hypothesis, GapSession], FloatArray]


def twins_for(hypothesis: Hypothesis, session: GapSession) -> tuple[Twin, ...]:
    """Laws other than the fitted one that can be computed for this sensor and these indenters."""
    balls = [i for i in session.samples.indenters if isinstance(i, Sphere)]
    force = session.samples.contacts.force_n[session.samples.touching]
    force = force[np.isfinite(force) & (force > 0)]
    surface = hypothesis.model.surface
    all_balls = len(balls) == len(session.samples.indenters)
    if all_balls and len(force) and isinstance(surface, Cylinder | Plane):
        stiffness, middle = hypothesis.model.elasticity_pa_per_m, float(np.median(force))
        layers = [alike_layer(surface, balls[0].radius_m, stiffness, middle, h) for h in THICKNESSES_M]
        return tuple(_layer(layer, stiffness) for layer in layers)
    return tuple(_power(n) for n in POWERS)


def _power(exponent: float) -> Twin:
    def values(hypothesis: Hypothesis, session: GapSession) -> FloatArray:
        law = {"stiffening": {"exponent": np.asarray(exponent)}}
        return hypothesis.with_effects(law).values(session)

    return Twin(f"power {exponent:g}", values)


def _layer(layer: Layer, alike_pa_per_m: float) -> Twin:
    def values(hypothesis: Hypothesis, session: GapSession) -> FloatArray:
        placed = hypothesis.placed(session).samples
        # A sensor with another E has a layer that is stiffer by as much.
        stiffer = hypothesis.model.elasticity_pa_per_m / alike_pa_per_m
        own = Layer(layer.thickness_m, layer.shear_modulus_pa * stiffer, layer.poisson)
        return session.means(layer_loads(hypothesis, placed, own) * hypothesis.model.scale_per_n)

    return Twin(f"layer {1e3 * layer.thickness_m:g} mm", values)


def alike_layer(
    surface: Cylinder | Plane, sphere_m: float, elasticity_pa_per_m: float, force_n: float, thickness_m: float
) -> Layer:
    """The layer of a thickness under which a press is as wide as under a foundation.

    Args:
        surface: what is pressed.
        sphere_m: radius of the indenter [m].
        elasticity_pa_per_m: E of the foundation.
        force_n: of the press [N].
        thickness_m: of the layer [m].
    """
    press = _press(surface, sphere_m)
    wanted = _width(press.axis_m, press.foundation_pa(elasticity_pa_per_m, force_n))
    factor, soft, stiff = 1.0, 0.0, np.inf
    layer = Layer.of_stiffness(elasticity_pa_per_m, thickness_m, _POISSON)
    for _ in range(_TRIES):
        try:
            wide = _width(press.axis_m, press.fields(layer, np.array([force_n]))[0].felt_pa) / wanted
        except SmallContactError:
            wide = 0.0
        except ContactError:
            # Soft: the ball sinks in beyond the grid.
            wide = np.inf
        if abs(wide - 1) < _ALIKE:
            break
        soft, stiff = (factor, stiff) if wide > 1 else (soft, factor)
        factor = 2 * soft if np.isinf(stiff) else stiff / 2 if soft == 0 else sqrt(soft * stiff)
        layer = Layer.of_stiffness(factor * elasticity_pa_per_m, thickness_m, _POISSON)
    return layer


def _press(surface: Surface, sphere_m: float) -> Press:
    radius = surface.radius_m if isinstance(surface, Cylinder) else float("inf")
    return Press(radius, sphere_m, _SPACING_M, min(_HALF_WIDTH_M, 0.98 * sphere_m))


def _width(axis_m: FloatArray, felt_pa: FloatArray) -> float:
    """Root mean square distance from the contact [m]."""
    square = axis_m**2
    moment = float(felt_pa.sum(axis=1) @ square + felt_pa.sum(axis=0) @ square)
    return sqrt(moment / float(felt_pa.sum()))


def layer_loads(hypothesis: Hypothesis, samples: Samples, layer: Layer) -> FloatArray:
    """Loads (K, J) of taxels under an elastic layer [N]."""
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
        table = _table(indenter, surface, layer, float(force.max()))
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


def _table(indenter: Indenter, surface: Surface, layer: Layer, most_n: float) -> _Table:
    assert isinstance(indenter, Sphere)
    # Rounded up, so that small moves of forces do not ask for another table.
    return _solved(_press(surface, indenter.radius_m), layer, exp(ceil(10 * log(most_n)) / 10))


@lru_cache(maxsize=32)
def _solved(press: Press, layer: Layer, most_n: float) -> _Table:
    forces = np.geomspace(_LEAST_FORCE * most_n, most_n, _FORCES)
    for _ in range(_TRIES):
        try:
            fields = press.fields(layer, forces)
        except SmallContactError:
            # At the smallest forces there is no cell in contact but one.
            factor = 0.5
        except ContactError:
            # At the largest forces the ball sinks in beyond the grid. Twice as stiff is a twin, too, though with
            # another E than asked for.
            factor = 2.0
        else:
            felt = np.stack([f.felt_pa for f in fields])
            return _Table(felt, np.log(forces), float(press.axis_m[0]))
        layer = Layer.of_stiffness(factor * layer.elasticity_pa_per_m, layer.thickness_m, layer.poisson)
    raise ContactError(f"no layer of {layer.thickness_m:g} m could be pressed on this grid")
