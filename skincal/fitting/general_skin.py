"""Load shares straight from the skin model, for any surface, indenter and contact normal."""

from __future__ import annotations

import numpy as np

from skincal.fitting.problem import FitProblem
from skincal.fitting.types import Floats, Ints
from skincal.model import Contacts, Converter, Patch, Skin, SkinParameters
from skincal.model.arrays import FloatArray

RESOLUTION_M = 0.25e-3
"""Cell size of the patch, as in the paper [m]."""

_CHUNK = 20_000
"""Contacts evaluated at a time, to bound memory."""


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

    @property
    def placed(self) -> bool:
        """Return whether every taxel fits on the surface at this pose."""
        return self.skin is not None

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
        """Return the share of the normal force that each taxel reports.

        Args:
            press: (n,) number of the press.
            slack_m: (n, 2) true minus measured contact position, across and along [m].
            log_ratio: (n,) log(F/E).

        Returns:
            (n, J) shares; zero if the taxels do not fit on the surface.
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
