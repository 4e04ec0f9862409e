"""Derivatives of the loads of closed forms: by force, elasticity, place of the contact and pose of the sensor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skincal.model.arrays import FloatArray, check_shape
from skincal.model.contact import Contacts
from skincal.model.indenters.indenter import ClosedForm
from skincal.model.patch import Patch
from skincal.model.press.call import press_slopes
from skincal.model.skin import Skin
from skincal.model.surfaces.surface import Surface

_STEP_M = 1e-5
"""Step of the central differences of smooth surfaces, good to some 1e-8 of a radius of 10 mm."""


@dataclass(frozen=True, eq=False)
class LoadDerivatives:
    """Loads of K contacts and what they change by.

    Attributes:
        loads_n: (K, J) [N].
        by_log_force: (K, J) by the logarithm of the force [N].
        by_motion: (K, M, J) by a unit of each motion [N].
        by_field: (K, G, J) by a unit of each field of points [N].
    """

    loads_n: FloatArray
    by_log_force: FloatArray
    by_motion: FloatArray
    by_field: FloatArray

    @property
    def by_log_elasticity(self) -> FloatArray:
        """(K, J) by the logarithm of E [N]: the share of the force depends on F / E only."""
        return self.loads_n - self.by_log_force


def load_derivatives(
    skin: Skin,
    indenter: ClosedForm,
    contacts: Contacts,
    motions: FloatArray | None = None,
    fields: FloatArray | None = None,
) -> LoadDerivatives:
    """Loads and their derivatives.

    The equilibrium is differentiated by the implicit function theorem, the distances of the points by central
    differences inside the routine. Right for what is summed over points that carry: at an indenter's rim (a flat
    punch that is moved along the skin) points come and go, which no derivative of the sum sees.

    Args:
        skin: the skin.
        indenter: a closed form.
        contacts: K contacts.
        motions: (K, M, 6) how the indenter moves with M parameters: velocity of its origin [m], turn [rad];
            see :func:`along_surface`.
        fields: (G, 6, N) how the patch's points and area vectors move with G parameters; see :func:`with_pose`.
    """
    moves = np.zeros((len(contacts), 0, 6)) if motions is None else motions
    flows = np.zeros((0, 6, len(skin.patch))) if fields is None else fields
    check_shape("motions", moves, (len(contacts), None, 6))
    check_shape("fields", flows, (None, 6, len(skin.patch)))
    elasticity = skin.parameters.elasticity_pa_per_m
    return LoadDerivatives(*press_slopes(skin.patch, elasticity, indenter, contacts, skin.law, moves, flows))


def along_surface(surface: Surface, contacts: Contacts) -> FloatArray:
    """Motions (K, 2, 6) of contacts across and along a surface, a metre of each; the normal turns with the surface's.

    Args:
        surface: the fingertip.
        contacts: K contacts on it.
    """
    motions = np.zeros((len(contacts), 2, 6))
    zero = np.zeros(len(contacts))
    origins = contacts.indenter_origins_m - contacts.points_m
    for m in range(2):
        step = [zero + _STEP_M * (m == 0), zero + _STEP_M * (m == 1)]
        low, high = (surface.offset(contacts.points_m, s * step[0], s * step[1]) for s in (-1, 1))
        normals = surface.normal_at(low), surface.normal_at(high)
        turn = np.cross((normals[0] + normals[1]) / 2, normals[1] - normals[0]) / (2 * _STEP_M)
        motions[:, m, :3] = (high - low) / (2 * _STEP_M) + np.cross(turn, origins)
        motions[:, m, 3:] = turn
    return motions


def with_pose(patch: Patch, low: Patch, high: Patch, change: float) -> FloatArray:
    """Field (6, N) of a patch's points and area vectors, from the same patch at poses a little less and a little more.

    Args:
        patch: at the pose.
        low: the same cells at half of the change less.
        high: at half of the change more.
        change: of the parameter of the pose between the two [m or rad].
    """
    check_shape("points of the patches", low.points_m, patch.points_m.shape)
    check_shape("points of the patches", high.points_m, patch.points_m.shape)
    both = [np.vstack([p.points_m.T, p.normals.T * p.areas_m2]) for p in (low, high)]
    return (both[1] - both[0]) / change
