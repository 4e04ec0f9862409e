"""Fingertip surfaces: one short file a kind."""

from skincal.model.surfaces.base import SensorPose, Surface
from skincal.model.surfaces.cylinder import Cylinder
from skincal.model.surfaces.mesh import MeshSurface
from skincal.model.surfaces.plane import Plane

__all__ = ["Cylinder", "MeshSurface", "Plane", "SensorPose", "Surface"]
