"""Patches of one layout at many poses: what does not depend on the pose is worked out once."""

from __future__ import annotations

from skincal.model import Cylinder, Patch, SensorPose, TaxelLayout

_MARGIN_M = 8e-3
"""How far the skin goes on around the taxels [m]."""


class PatchMould:
    """Lays the same cells on a cylinder at one pose after the other.

    The patches are those of :meth:`skincal.model.Patch.build`; the compact tiles are those found at one pose, as
    neighbours stay neighbours.

    Args:
        surface: the fingertip.
        layout: the taxels.
        resolution_m: longest edge of a cell [m].
    """

    def __init__(
        self,
        surface: Cylinder,
        layout: TaxelLayout,
        resolution_m: float = 0.25e-3,
    ) -> None:
        self._surface = surface
        # Always at the same pose: the order of sums must not depend on what was asked for before.
        self._first = Patch.build(surface, layout, SensorPose(0.0, 0.0), resolution_m, _MARGIN_M)

    def at(self, pose: SensorPose) -> Patch:
        """Return the patch at a pose."""
        first = self._first
        assert first.uv_m is not None
        points, normals = self._surface.wrap(pose, first.uv_m)
        return first.moved(points, normals)
