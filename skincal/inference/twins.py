"""Twins: this session with nothing hidden, simulated under other contact laws for the null.

Where spheres press a cylinder or a plane, the twins are elastic layers of three thicknesses
(:mod:`skincal.inference.elastic_layer`), with the stiffness at which a press spreads as far as under the fitted law;
the thickest is nearly a half-space. For other shapes the stress grows as another power of the penetration.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.interpolate import PchipInterpolator

from skincal.inference.elastic_layer import ContactError, Layer, Press, SmallContactError
from skincal.inference.forward import LAW, Forward, State
from skincal.inference.paths import LEAST_M
from skincal.inference.press_table import NODES, Presses, PressTable, press_table
from skincal.model import ContactLaw, Patch, Sphere, StressLaw
from skincal.model.arrays import FloatArray

_NODES_M = 1.5e-4
"""Spacing of the nodes between which loads of a contact that moves are interpolated [m]."""
LAWS = {"layer": (1e-3, 3e-3, 10e-3), "power": (0.85, 1.2)}
"""Thicknesses [m] of elastic layers, and powers of the stress where no layer can be solved."""
_POISSON, _SPACING_M, _HALF_WIDTH_M, _CONVERGED, _FORCES, _TRIES, _TOLERANCE = (
    0.4,
    0.25e-3,
    6e-3,
    1e-4,
    12,
    7,
    0.02,
)
_NARROWS = 0.28
"""Exponent of the width of a contact in 1 / stiffness: between 1/4 on a foundation and 1/3 on a half-space."""


def law_name(law: str, number: float) -> str:
    """Return the name of a law of ``LAWS`` for readers."""
    return f"{law} {1e3 * number:g} mm" if law == "layer" else f"{law} {number:g}"


def twin_values(forward: Forward, state: State, law: str, number: float) -> FloatArray | None:
    """Compute levels (K, J) above rest under another law of ``LAWS``; None where it cannot be solved."""
    f, e, bare = forward, float(np.exp(state.log_e)), float(state.law[-1])
    plain = replace(state, effects={}, law=np.zeros(len(LAW)))
    skin = f.skin(plain)
    paths = f.paths(_NODES_M, LEAST_M)
    presses, things = f.presses_at(paths.nodes_at(state.move[:, :2]), paths.press), f.samples.indenters
    if law == "power":
        stress = StressLaw(number, 5e-4)
        table = press_table(skin.skin.patch, f.surface, things, presses, e, stress, bare=bare, lattice=False)
    elif f.surface.is_uniform and all(isinstance(i, Sphere) for i in things):
        table = _layer_table(f, skin.skin.patch, presses, e, f.contact_law(state.law), bare, number)
    else:
        table = None
    if table is None:
        return None
    return skin.after(e * paths.between_nodes(table, f.force_n(f.samples, plain) / e), f.samples, {})


def _layer_table(
    forward: Forward, patch: Patch, presses: Presses, e: float, law: ContactLaw, bare: float, thick: float
) -> PressTable | None:
    surface = forward.surface
    felt = np.flatnonzero(patch.taxel >= 0)
    points, areas, taxel = patch.points_m[felt], patch.areas_m2[felt], patch.taxel[felt]
    owner = np.zeros((len(felt), patch.layout.taxels))
    owner[np.arange(len(felt)), taxel] = areas
    most = presses.most_n / e
    out = np.zeros((1, len(most), NODES, patch.layout.taxels))
    share = np.linspace(0.0, 1.0, NODES)
    radius = surface.arc_radius_m or float("inf")
    factor = 0.0
    for number, ball in enumerate(forward.samples.indenters):
        rows = np.flatnonzero((presses.indenter == number) & np.isfinite(presses.points_m).all(axis=1))
        if not len(rows):
            continue
        assert isinstance(ball, Sphere)
        half = min(_HALF_WIDTH_M, 0.98 * ball.radius_m)
        press = Press(radius, ball.radius_m, _SPACING_M, half, _CONVERGED)
        top = float(presses.most_n[rows].max())
        stiff = e * (factor or _matching_stiffness(press, e, law, 0.4 * top, thick))
        factor = factor or stiff / e
        solved = _solved(
            press, Layer.of_stiffness(stiff, thick, _POISSON), np.geomspace(0.01 * top, top, _FORCES)
        )
        if solved is None:
            return None
        forces, fields = solved
        about = surface.project(presses.points_m[rows])[:, None]
        arc, along = np.stack([surface.unrolled(points, contact) for contact in about]).transpose(2, 0, 1)
        loads = np.zeros((len(rows), len(forces) + 1, owner.shape[1]))
        for k, field in enumerate(fields):
            spot = field.felt_at(arc, along, bare)
            loads[:, k + 1] = spot @ owner
        curve = PchipInterpolator(np.sqrt(np.append(0.0, forces)), loads, axis=1)
        for i, p in enumerate(rows.tolist()):
            own = PchipInterpolator(curve.x, loads[i], axis=0) if len(rows) > 1 else curve
            asked = np.minimum(share * np.sqrt(presses.most_n[p]), curve.x[-1])
            out[0, p] = (own(asked) if len(rows) > 1 else own(asked)[0]) / e
    return PressTable(out, most)


def _matching_stiffness(press: Press, e: float, law: ContactLaw, force_n: float, thick: float) -> float:
    """Return a layer's stiffness over the foundation's at which a press spreads as under the fitted law."""

    def width(felt: FloatArray) -> float:
        square = press.axis_m**2
        return float(np.sqrt((felt.sum(axis=1) @ square + felt.sum(axis=0) @ square) / felt.sum()))

    ball = Sphere(press.sphere_radius_m)
    fitted = replace(press, sphere_radius_m=law.radius_scale * ball.radius_m)
    wanted = width(fitted.foundation_pa(e * law.stiffness(ball), force_n, law.stress(None)))
    wanted = float(np.sqrt(max(wanted**2 + 2 * law.spread_m2, 0.25 * wanted**2)))
    low, high, factor = 0.05, 20.0, 1.0
    for _ in range(_TRIES):
        try:
            wide = width(
                press.fields(Layer.of_stiffness(factor * e, thick, _POISSON), np.array([force_n]))[0].felt_pa
            )
        except SmallContactError:
            wide = 0.0
        except ContactError:
            wide = np.inf
        low, high = (factor, high) if wide > wanted else (low, factor)
        if abs(wide / wanted - 1) < _TOLERANCE:
            break
        near = factor * (wide / wanted) ** (1 / _NARROWS)
        factor = float(near if low < near < high else np.sqrt(low * high))
    return factor


def _solved(press: Press, layer: Layer, forces: FloatArray):
    for _ in range(_TRIES):
        try:
            return forces, press.fields(layer, forces)
        except SmallContactError:
            # At the smallest force a single cell is in contact: begin at the next one.
            forces = forces[1:]
            if len(forces) < 5:
                layer = Layer.of_stiffness(0.5 * layer.elasticity_pa_per_m, layer.thickness_m, layer.poisson)
        except ContactError:
            # The sphere sinks in beyond the grid: take a layer twice as stiff.
            layer = Layer.of_stiffness(2.0 * layer.elasticity_pa_per_m, layer.thickness_m, layer.poisson)
    return None
