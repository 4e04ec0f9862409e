"""Indenters: one file per kind."""

from skincal.model.indenters.flat import FlatPunch
from skincal.model.indenters.indenter import ClosedForm, Indenter, RayHits
from skincal.model.indenters.mesh import MeshIndenter
from skincal.model.indenters.sphere import Sphere

__all__ = ["ClosedForm", "FlatPunch", "Indenter", "MeshIndenter", "RayHits", "Sphere"]
