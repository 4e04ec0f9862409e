"""The interface of the compiled routine: presses of contacts, and the force equilibrium by itself.

numba is imported at the first press.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from skincal.model.arrays import FloatArray, IntArray, check_shape
from skincal.model.contact import Contacts
from skincal.model.indenters.indenter import ClosedForm, Indenter
from skincal.model.indenters.mesh import MeshIndenter
from skincal.model.law import StressLaw

if TYPE_CHECKING:
    from skincal.model.patch import Patch

INFO = 7
"""Number of values per press in ``info``: penetration, force, centroid (3), points in contact, status."""
_MARGIN, _QUANTILE, _DECAY, _MOST_AHEAD = 1.01, 0.9, 0.2, 4.0
"""Adaptation of ``MeshIndenter.ahead``: safety margin over the depth that was needed, quantile of the presses that it
covers, decay rate after a press that needed more, and upper bound. Tuned by eye on the meshes of
``benchmarks/model_speed.py``; results do not depend on them."""
_SHALLOW_M = 1e-6
"""Smallest penetration from which ``MeshIndenter.ahead`` adapts [m]."""
_AT_ONCE = 256
"""Number of places of a mesh whose rays are cast at once, to bound memory."""
_NO_ENTRIES = np.zeros(0, dtype=np.int64), np.zeros(0)
_routine: Any = None


def routine() -> Any:
    """Return the compiled routine, which is compiled or loaded from the cache at first use."""
    global _routine
    if _routine is None:
        from skincal.model.press import compiled

        _routine = compiled.Routine()
    return _routine


Entries = tuple[IntArray, IntArray, FloatArray]
"""Start of each press (K,) in the two output arrays, which are filled: tiled points (n,) and their loads (n,) [N]."""


def press(
    patch: Patch,
    elasticity_pa_per_m: float,
    indenter: Indenter,
    contacts: Contacts,
    law: StressLaw | None,
    entries: Entries | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Return loads (K, J) [N] of contacts, and further results (K, 7), see :data:`INFO`.

    Args:
        patch: the tactile points.
        elasticity_pa_per_m: E [Pa/m].
        indenter: the indenter.
        contacts: K contacts.
        law: stress law; None: proportional.
        entries: if given, output arrays for the points that each press touches.
    """
    count = len(contacts)
    tiled, compiled = patch.tiled, _routine or routine()
    loads, info = np.zeros((count, patch.layout.taxels)), np.zeros((count, INFO))
    where = _rows(contacts)
    exponent, reference = (1.0, 1.0) if law is None else (law.exponent, law.reference_m)
    stress = elasticity_pa_per_m, exponent, reference
    points_out = (np.zeros(count, dtype=np.int64), *_NO_ENTRIES) if entries is None else entries
    through = min(indenter.depth_m, patch.depth_m)
    ground = tiled.points, tiled.taxel, tiled.border
    if isinstance(indenter, ClosedForm):
        compiled.press(
            *ground, tiled.tiles, indenter.kind, indenter.radius_m, through, *where, *stress, loads, info,
            *points_out,
        )  # fmt: skip
        return loads, info
    assert isinstance(indenter, MeshIndenter)
    starts, at = np.empty(count + 1, dtype=np.int64), np.empty(count, dtype=np.int64)
    places = compiled.group(*where, loads, info, starts, at)
    given = (*ground, through, *where, *stress, loads, info, *points_out)
    for k in range(0, places, _AT_ONCE):
        end = min(k + _AT_ONCE, places)
        _press_mesh(indenter, tiled.tiles, given, starts[k : end + 1], at[k:end])
    return loads, info


def _rows(contacts: Contacts) -> tuple[FloatArray, bool, FloatArray]:
    """Return contacts as arguments of the routine: rows (K, 18), whether rotations are given, and forces (K,) [N]."""
    rows = np.empty((len(contacts), 18))
    rows[:, :3] = contacts.normals
    rows[:, 3:6] = contacts.indenter_origins_m
    rows[:, 15:] = contacts.points_m
    rotations = contacts.rotations
    if rotations is not None:
        rows[:, 6:15] = rotations.reshape(-1, 9)
    return rows, rotations is not None, contacts.force_n.copy()


def _press_mesh(
    indenter: MeshIndenter, tiles: FloatArray, given: tuple[Any, ...], starts: IntArray, at: IntArray
) -> None:
    """Press a mesh at P places: cast rays at the points nearer than a limit, and repeat where the limit was too low.

    Args:
        indenter: the mesh.
        tiles: (11, B) tiles of the patch.
        given: the first arguments of :func:`skincal.model.press.casting.press_cast`, up to the entries.
        starts: (P + 1,) first sample of each place.
        at: (P,) row of each place.
    """
    mesh, compiled = indenter.mesh, routine()
    points, rows, turned, force, elasticity, exponent, reference, info = (
        given[0], *given[4:10], given[11]
    )  # fmt: skip
    bounds = _bounds(indenter, rows, turned, at)
    limits, again = np.full(len(at), -np.inf), np.ones(len(at), dtype=np.bool_)
    begins, guesses = np.empty(len(at) + 1, dtype=np.int64), np.empty((2, len(at)))
    while again.any():
        which, origins, ways = compiled.select(
            points, tiles, rows, turned, force, elasticity, exponent, reference, info, starts, at, bounds,
            limits, guesses, indenter.ahead, again, mesh.centre_m, 1.01 * mesh.radius_m, mesh.rays.scale, begins,
        )  # fmt: skip
        compiled.press_cast(
            *given, starts, at, which, begins, mesh.rays.run(origins, ways), mesh.normals, mesh.heights,
            mesh.centre_m, limits, again,
        )  # fmt: skip
    _adapt_ahead(indenter, limits, guesses)


def _adapt_ahead(indenter: MeshIndenter, levels: FloatArray, guesses: FloatArray) -> None:
    """Set the search depth of the mesh's next press to what most of these presses needed, to save rays.

    Args:
        indenter: the mesh; its ``ahead`` is changed.
        levels: (P,) levels that were found [m].
        guesses: (2, P) predicted levels, and distances of first touch [m].
    """
    needed = sorted(
        (level - first) / (guess - first)
        for level, guess, first in zip(levels.tolist(), *guesses.tolist(), strict=True)
        if level < np.inf and guess < np.inf and guess - first > _SHALLOW_M
    )
    if needed:
        target = _MARGIN * needed[int(_QUANTILE * (len(needed) - 1))]
        decayed = max(target, indenter.ahead + _DECAY * (target - indenter.ahead))
        indenter.ahead = min(max(decayed, 1.0), _MOST_AHEAD)


def _bounds(indenter: MeshIndenter, rows: FloatArray, turned: bool, at: IntArray) -> FloatArray:
    """Return bounds of the mesh's parts (P, Q, 13), or (1, Q, 13) if they are the same for all presses."""
    upright = not turned and bool((rows[at, 3:6] == rows[at, 15:]).all())
    if upright and indenter.upright is not None:
        return indenter.upright
    some = at[:1] if upright else at
    vertices, parts, axes, middles = indenter.hulls
    bounds = np.empty((len(some), len(axes), 13))
    routine().enclose(vertices, parts, axes, middles, rows, turned, some, bounds)
    if upright:
        indenter.upright = bounds
    return bounds


def solve_penetration(gap_m: ArrayLike, weight_m2: ArrayLike, force_over_elasticity: ArrayLike) -> FloatArray:
    """Solve the force equilibrium for the penetration p: sum_i w_i max(p - g_i, 0) = F / E.

    This is the paper's equation 5, with eps_i = max(eps_max - (d_i - delta), 0) (equation 7) and
    w_i = a_i max(n_t,i . n_c, 0). A constant added to all gaps of a press (such as delta) is added to the result; the
    local penetrations do not change.

    Args:
        gap_m: (K, N) gap of every point at first touch [m]; inf where the indenter cannot touch.
        weight_m2: (K, N) or (N,) projected areas [m²], zero for points that face away.
        force_over_elasticity: (K,) force over elasticity F / E [m³].

    Returns:
        (K,) penetration [m]. A force of zero or less gives the smallest gap (first touch); a force that is NaN or
        infinite gives NaN. If no point can be touched, the penetration is 0.

    Raises:
        ValueError: shapes do not match.
    """
    load = np.array(force_over_elasticity, dtype=np.float64)
    gap = np.array(gap_m, dtype=np.float64)
    check_shape("force_over_elasticity", load, (None,))
    check_shape("gap_m", gap, (len(load), None))
    weight = np.array(np.broadcast_to(np.asarray(weight_m2, dtype=np.float64), gap.shape))
    met = (weight > 0) & (gap < np.inf)
    first = np.where(met, gap, np.inf).min(axis=1, initial=np.inf)
    first[first == np.inf] = 0.0
    gap, weight = np.where(met, gap - first[:, None], np.inf), np.where(met, weight, 0.0)
    depth = np.zeros(len(load))
    pressed = np.isfinite(load) & (load > 0) & met.any(axis=1)
    for k in np.flatnonzero(pressed):
        some = met[k]
        depth[k] = routine().depth(gap[k, some], weight[k, some], int(some.sum()), load[k], 0.0)
    return np.where(np.isfinite(load), first + depth, np.nan)
