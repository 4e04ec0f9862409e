"""From contacts to the compiled routine and back; the force equilibrium by itself.

numba is imported when the first press is computed.
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
"""Numbers that the routine tells of a press: penetration, force, centroid (3), points touched, status."""
_MARGIN, _ENOUGH, _FORGET, _MOST_AHEAD = 1.01, 0.9, 0.2, 4.0
"""How far a mesh is looked at beyond what was needed, for which part of the presses, how soon a press that needed more
is forgotten, and the most. Tuned by eye on the meshes of ``benchmarks/model_speed.py``; results do not depend on it."""
_SHALLOW_M = 1e-6
"""Presses that are less deep say nothing of how far to look [m]."""
_AT_ONCE = 256
"""Places of a mesh that are cast at once, to bound memory."""
_NOTHING = np.zeros(0, dtype=np.int64), np.zeros(0)
_routine: Any = None


def routine() -> Any:
    """Return the compiled routine, made or fetched from the cache at first use."""
    global _routine
    if _routine is None:
        from skincal.model.press import compiled

        _routine = compiled.Routine()
    return _routine


Entries = tuple[IntArray, IntArray, FloatArray]
"""Where each press begins in the others (K,), and arrays to be filled: tiled points (n,) and loads on them (n,) [N]."""


def press(
    patch: Patch,
    elasticity_pa_per_m: float,
    indenter: Indenter,
    contacts: Contacts,
    law: StressLaw | None,
    entries: Entries | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Return loads (K, J) [N] of contacts, and what else there is to tell of them (K, 7).

    Args:
        patch: the tactile points.
        elasticity_pa_per_m: E [Pa/m].
        indenter: what presses.
        contacts: K contacts.
        law: how stress grows with penetration; None: in proportion.
        entries: filled with the points that each press touches, if given.
    """
    count = len(contacts)
    tiled, compiled = patch.tiled, _routine or routine()
    loads, info = np.zeros((count, patch.layout.taxels)), np.zeros((count, INFO))
    where = _rows(contacts)
    exponent, reference = (1.0, 1.0) if law is None else (law.exponent, law.reference_m)
    how = elasticity_pa_per_m, exponent, reference
    told = (np.zeros(count, dtype=np.int64), *_NOTHING) if entries is None else entries
    through = min(indenter.depth_m, patch.depth_m)
    ground = tiled.points, tiled.taxel, tiled.border
    if isinstance(indenter, ClosedForm):
        compiled.press(
            *ground, tiled.tiles, indenter.kind, indenter.radius_m, through, *where, *how, loads, info, *told
        )
        return loads, info
    assert isinstance(indenter, MeshIndenter)
    starts, at = np.empty(count + 1, dtype=np.int64), np.empty(count, dtype=np.int64)
    places = compiled.group(*where, loads, info, starts, at)
    given = (*ground, through, *where, *how, loads, info, *told)
    for k in range(0, places, _AT_ONCE):
        end = min(k + _AT_ONCE, places)
        _cast(indenter, tiled.tiles, given, starts[k : end + 1], at[k:end])
    return loads, info


def _rows(contacts: Contacts) -> tuple[FloatArray, bool, FloatArray]:
    """Return contacts as the routine takes them: rows (K, 18), whether they are turned, and forces (K,)."""
    rows = np.empty((len(contacts), 18))
    rows[:, :3] = contacts.normals
    rows[:, 3:6] = contacts.indenter_origins_m
    rows[:, 15:] = contacts.points_m
    rotations = contacts.rotations
    if rotations is not None:
        rows[:, 6:15] = rotations.reshape(-1, 9)
    return rows, rotations is not None, contacts.force_n.copy()


def _cast(
    indenter: MeshIndenter, tiles: FloatArray, given: tuple[Any, ...], starts: IntArray, at: IntArray
) -> None:
    """Press a mesh at some places: cast what may be nearer than a limit, and again where the limit was too low."""
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
    _look_as_far_as_needed(indenter, limits, guesses)


def _look_as_far_as_needed(indenter: MeshIndenter, levels: FloatArray, guesses: FloatArray) -> None:
    """Let the next press of a mesh look as deep as nine of ten of these needed: it saves rays, no more."""
    needed = sorted(
        (level - first) / (guess - first)
        for level, guess, first in zip(levels.tolist(), *guesses.tolist(), strict=True)
        if level < np.inf and guess < np.inf and guess - first > _SHALLOW_M
    )
    if needed:
        most = _MARGIN * needed[int(_ENOUGH * (len(needed) - 1))]
        kept = max(most, indenter.ahead + _FORGET * (most - indenter.ahead))
        indenter.ahead = min(max(kept, 1.0), _MOST_AHEAD)


def _bounds(indenter: MeshIndenter, rows: FloatArray, turned: bool, at: IntArray) -> FloatArray:
    """Bound the parts of the mesh (P, Q, 13), or (1, Q, 13) where that is the same for all presses."""
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
    """Return the penetration at which the stresses carry the force: sum_i w_i max(p - g_i, 0) = F / E.

    This is the paper's equation 5, with eps_i = max(eps_max - (d_i - delta), 0) (equation 7) and
    w_i = a_i max(n_t,i . n_c, 0).
    Any constant may be added to a press's gaps (as from d_i - delta to d_i): it is added to the result, and the
    local penetrations stay what they are.

    Args:
        gap_m: (K, N) gap of every point at first touch [m]; inf where the indenter cannot touch.
        weight_m2: (K, N) or (N,) projected areas [m²], zero for points that face away.
        force_over_elasticity: (K,) force over elasticity F / E [m³].

    Returns:
        (K,) penetration [m]. A force of zero or less gives the smallest gap (first touch: no point is
        penetrated); NaN or infinity gives NaN. Where no point can be touched it is 0, and no point is penetrated.

    Raises:
        ValueError: shapes that do not fit.
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
