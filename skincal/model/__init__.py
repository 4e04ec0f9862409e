"""The skin model: surface, taxel layout, contact and skin (Kasolowsky & Bäuml, IROS 2024, section II)."""

from skincal.model.contact import Contacts, contact_rotations
from skincal.model.indenters import ClosedForm, FlatPunch, Indenter, MeshIndenter, RayHits, Sphere
from skincal.model.law import ContactLaw, StressLaw
from skincal.model.layout import TaxelLayout
from skincal.model.patch import Patch, patch_cells
from skincal.model.press.call import solve_penetration
from skincal.model.response import Pressures, SkinResponse, Status
from skincal.model.skin import Converter, Skin, SkinParameters
from skincal.model.surfaces import Cylinder, MeshSurface, Plane, SensorPose, Surface

__all__ = [
    "ClosedForm", "ContactLaw", "Contacts", "Converter", "Cylinder", "FlatPunch", "Indenter", "MeshIndenter",
    "MeshSurface", "Patch", "Plane", "Pressures", "RayHits", "SensorPose", "Skin", "SkinParameters",
    "SkinResponse", "Sphere", "Status", "StressLaw", "Surface", "TaxelLayout", "contact_rotations",
    "patch_cells", "solve_penetration",
]  # fmt: skip
