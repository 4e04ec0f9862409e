"""Kinds of surfaces and indenters: what ``kind`` may say in a file, which keys go with it, and its object in the model.

A new kind is a file in ``model/surfaces`` or ``model/indenters`` and a line in one of these tables.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True)
class Kind:
    """A kind of surface or indenter.

    Attributes:
        model: name of its class in ``skincal.model``, built from a radius [m], from a mesh, or from nothing.
        radius: what ``radius_m`` is; '' where it has none.
        mesh: whether ``file`` names its mesh.
        plane: of a surface, whether the sensor's position is ``x_m``, ``y_m`` instead of ``beta_deg``, ``y_m``.
    """

    model: str
    radius: str = ""
    mesh: bool = False
    plane: bool = False


SURFACES: Final = {
    "cylinder": Kind("Cylinder", radius="the cylinder's radius [m]"),
    "plane": Kind("Plane", plane=True),
    "mesh": Kind("MeshSurface", mesh=True),
}
"""What ``[surface] kind`` may be."""

INDENTERS: Final = {
    "sphere": Kind("Sphere", radius="the sphere's radius [m]"),
    "flat": Kind("FlatPunch", radius="the punch's radius [m]"),
    "mesh": Kind("MeshIndenter", mesh=True),
}
"""What ``[indenter] kind`` may be."""
