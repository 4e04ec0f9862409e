"""Fingertip surfaces: one file per kind."""

from skincal.model.surfaces.cylinder import Cylinder
from skincal.model.surfaces.mesh import MeshSurface
from skincal.model.surfaces.plane import Plane
from skincal.model.surfaces.surface import SensorPose, Surface

__all__ = ["Cylinder", "MeshSurface", "Plane", "SensorPose", "Surface"]
