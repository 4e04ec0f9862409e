"""Presses on any surface: their contacts in space as functions of the slack, and load shares from the skin model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from skincal.fitting.lookup import look_up_cubic
from skincal.fitting.types import Floats, Ints
from skincal.model import Contacts, Converter, Patch, Skin, SkinParameters, Surface
from skincal.model.arrays import FloatArray

if TYPE_CHECKING:
    from skincal.fitting.general_local import LocalPlaces
    from skincal.fitting.problem import FitProblem

_STEP_M = 0.5e-3
"""Step of the lattice on which the surface around a press is tabled [m]. Cubic look-ups are accurate to a
micrometre on a fingertip; the facets of a mesh are coarser."""

_MOST_NODES = 41
"""Most nodes along one side of the lattice."""

TABLE_MARGIN_M = 2.5e-3
"""Extent of the table beyond the slack, as the sensor's pose is not known yet [m]."""

RESOLUTION_M = 0.25e-3
"""Cell size of the patch, as in the paper [m]."""

_CHUNK = 20_000
"""Contacts evaluated at a time, to bound memory."""


@dataclass(frozen=True, eq=False)
class ContactMap:
    """Contact points and normals of presses, moved along the surface from where they were measured.

    Attributes:
        measured_m: (K, 3) measured contact points on the surface [m].
        planes: (K, 6, N, N) float32: offset of the contact point from there [m] and contact normal, on a
            lattice of slacks across and along.
        slot: (M,) for every press of the session its row in the arrays above, or -1.
        half_m: largest slack that is looked up [m]; larger slacks are clamped to it.
        measured_normals: whether normals were measured; they then stay fixed when a contact moves.
        local: the presses on the uniform local surface; None if there is none.
        skin_on_grid: whether the grid uses the skin model itself even if there is a local surface.
    """

    measured_m: Floats
    planes: Floats
    slot: Ints
    half_m: float
    measured_normals: bool
    local: LocalPlaces | None = None
    skin_on_grid: bool = False

    @property
    def local_on_grid(self) -> LocalPlaces | None:
        """The presses on the local surface if the grid uses it; None if the grid uses the skin model itself."""
        return None if self.skin_on_grid else self.local

    @classmethod
    def of(
        cls, surface: Surface, points_m: Floats, rows: Ints, half_m: float, normals: Floats | None = None
    ) -> ContactMap:
        """Table the surface around the presses ``rows`` (K,) of a session, up to a slack of ``half_m``.

        Contact points (M, 3) [m] and normals (M, 3) are those measured in the session; normals are None or NaN
        for the surface's own.
        """
        count = min(int(np.ceil(half_m / _STEP_M)), (_MOST_NODES - 1) // 2)
        step = half_m / count
        # Two more nodes on every side, so that a look-up at the edge has all its neighbours.
        axis = np.arange(-count - 2, count + 3) * step
        across, along = (a.ravel() for a in np.meshgrid(axis, axis, indexing="ij"))
        planes = np.zeros((len(rows), 6, len(axis), len(axis)), dtype=np.float32)
        centres = surface.project(points_m[rows])
        for k, row in enumerate(rows):
            points = surface.offset(np.tile(centres[k], (len(across), 1)), across, along)
            points = _keep_on_surface(points, across, along)
            own = surface.normal_at(points)
            if normals is not None and np.isfinite(normals[row]).all():
                own = np.tile(normals[row], (len(own), 1))
            both = np.concatenate([points - centres[k], own], axis=1)
            planes[k] = both.T.reshape(6, len(axis), len(axis))
        slot = np.full(len(points_m), -1, dtype=np.intp)
        slot[rows] = np.arange(len(rows))
        measured = normals is not None and bool(np.isfinite(normals[rows]).any())
        return cls(centres, planes, slot, count * step, measured)

    def at(self, rows: Ints, slack_m: Floats) -> tuple[FloatArray, FloatArray]:
        """Return contact points (n, 3) [m] and unit normals (n, 3) of presses ``rows`` (n,) at slacks (n, 2) [m]."""
        slot, count = self.slot[rows], len(rows)
        side = self.planes.shape[-1]
        step = 2 * self.half_m / (side - 5)
        place = (np.clip(slack_m, -self.half_m, self.half_m) / step + (side - 1) / 2).astype(np.float32)
        plane = (slot[:, None] * 6 + np.arange(6)).ravel()
        row, col = np.repeat(place[:, 0], 6), np.repeat(place[:, 1], 6)
        got = look_up_cubic(self.planes.reshape(-1, side, side), plane, row, col)[0].reshape(count, 6)
        points = np.asarray(self.measured_m[slot] + got[:, :3], dtype=np.float64)
        normals = got[:, 3:].astype(np.float64)
        return points, normals / np.linalg.norm(normals, axis=1, keepdims=True)


def _keep_on_surface(points_m: Floats, across_m: Floats, along_m: Floats) -> Floats:
    """Return points (N, 3) with those beyond the surface (NaN) replaced by the nearest one on it."""
    lost = ~np.isfinite(points_m).all(axis=1)
    if not lost.any():
        return points_m
    kept = np.flatnonzero(~lost)
    apart = np.hypot(across_m[lost, None] - across_m[kept], along_m[lost, None] - along_m[kept])
    points_m = points_m.copy()
    points_m[lost] = points_m[kept[np.argmin(apart, axis=1)]]
    return points_m


class SkinShares:
    """The skin at one pose of the sensor.

    The patch is laid on the surface once and serves all elasticities: stress and force both scale with E, so
    the share of the force that a taxel reports depends on F/E only.

    Args:
        problem: presses with contacts in space.
        across_m: the sensor's centre around the surface, arc length R beta, or x on a plane [m].
        y_m: the same along the axis [m].
        alpha_rad: turn [rad].
        resolution_m: cell size of the patch [m].
    """

    def __init__(
        self,
        problem: FitProblem,
        across_m: float,
        y_m: float,
        alpha_rad: float,
        *,
        resolution_m: float = RESOLUTION_M,
    ) -> None:
        assert problem.contacts is not None
        self.problem, self.contacts = problem, problem.contacts
        rig = problem.rig
        try:
            patch = Patch.build(rig.surface, rig.layout, rig.pose(across_m, y_m, alpha_rad), resolution_m)
        except ValueError:
            self.skin: Skin | None = None
        else:
            self.skin = Skin(patch, SkinParameters(1.0, 1.0), Converter.none())

    def lost_m2(self) -> FloatArray:
        """Return the variance (2,) along u and v that a taxel loses when its load is summed over cell centres [m²].

        Along an axis with cells of length h, the centres have h²/12 less variance than the cells. Images are
        therefore sharper than those of whole taxels, which would bias the fit towards a softer skin. The
        result is zero if the taxels do not fit on the surface.
        """
        if self.skin is None or self.skin.patch.uv_m is None:
            return np.zeros(2)
        patch, layout = self.skin.patch, self.problem.rig.layout
        sensed = patch.taxel >= 0
        taxel, area = patch.taxel[sensed], patch.areas_m2[sensed]
        offset = self.skin.patch.uv_m[sensed] - layout.centres_m[taxel]
        total = np.bincount(taxel, area, layout.taxels)
        squares = [
            np.bincount(taxel, area * d**2, layout.taxels) / np.maximum(total, 1e-30) for d in offset.T
        ]
        return np.maximum((layout.sizes_m**2 / 12 - np.transpose(squares)).mean(axis=0), 0.0)

    def shares(self, press: Ints, slack_m: Floats, log_ratio: Floats) -> Floats:
        """Return the share (n, J) of the normal force that each taxel reports; zero if the taxels do not fit.

        ``slack_m`` (n, 2) is the true minus the measured contact position across and along, ``log_ratio`` (n,)
        log(F/E).
        """
        out = np.zeros((len(press), self.problem.rig.layout.taxels))
        if self.skin is None:
            return out
        kinds, rows = self.problem.indenter[press], self.problem.rows[press]
        ratio = np.exp(np.asarray(log_ratio, dtype=np.float64))
        for kind in np.unique(kinds):
            same = np.flatnonzero(kinds == kind)
            for part in np.split(same, np.arange(_CHUNK, len(same), _CHUNK)):
                points, normals = self.contacts.at(rows[part], slack_m[part])
                # With E = 1 Pa/m, a force of F/E newtons presses as deep as F does on the
                # real skin.
                contacts = Contacts(points, normals, ratio[part])
                loads = self.skin.loads(self.problem.rig.indenters[int(kind)], contacts)
                out[part] = np.nan_to_num(loads) / ratio[part, None]
        return out
