"""Kinds of surfaces and indenters: the values of ``kind`` in a file, their keys, and their classes in the model.

A new kind needs a class in ``model/surfaces`` or ``model/indenters``, exported by ``skincal.model``, and a line in one
of these tables; a number with a new key also needs a field in ``dataset/spec.py``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final


@dataclass(frozen=True)
class Kind:
    """A kind of surface or indenter.

    Attributes:
        model: name of the class in ``skincal.model``, which is built from ``numbers``, from a mesh, or without
            arguments.
        numbers: descriptions of the numbers that a file gives, by key.
        mesh: True if ``file`` names a mesh.
        plane: True for a surface on which the sensor's position is ``x_m``, ``y_m`` instead of ``beta_deg``, ``y_m``.
        on_hand: True if a hand may have it: guard, press control and simulated hand need contacts in closed form.
        in_tasks: True for a surface that the tasks support: they roll objects around a finger of one radius.
    """

    model: str
    numbers: Mapping[str, str] = field(default_factory=dict[str, str])
    mesh: bool = False
    plane: bool = False
    on_hand: bool = False
    in_tasks: bool = False


SURFACES: Final = {
    "cylinder": Kind("Cylinder", {"radius_m": "the cylinder's radius [m]"}, on_hand=True, in_tasks=True),
    "plane": Kind("Plane", plane=True, on_hand=True),
    "mesh": Kind("MeshSurface", mesh=True),
}
"""Values of ``[surface] kind``."""

INDENTERS: Final = {
    "sphere": Kind("Sphere", {"radius_m": "the sphere's radius [m]"}, on_hand=True),
    "flat": Kind("FlatPunch", {"radius_m": "the punch's radius [m]"}),
    "mesh": Kind("MeshIndenter", mesh=True),
}
"""Values of ``[indenter] kind``."""


def named(kinds: Mapping[str, Kind], attribute: str) -> str:
    """Return the names of the kinds with a true attribute, as words of a message."""
    return " or ".join(f'"{name}"' for name, kind in kinds.items() if getattr(kind, attribute))
