"""Kinds of surfaces and indenters: what ``kind`` may say in a file, which keys go with it, and its object in the model.

A new kind is a file in ``model/surfaces`` or ``model/indenters`` and a line in one of these tables.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final


@dataclass(frozen=True)
class Kind:
    """A kind of surface or indenter.

    Attributes:
        model: name of its class in ``skincal.model``, built from ``numbers``, from a mesh, or from nothing.
        numbers: what each number is that a file gives for it, by key.
        mesh: whether ``file`` names its mesh.
        plane: of a surface, whether the sensor's position is ``x_m``, ``y_m`` instead of ``beta_deg``, ``y_m``.
        on_hand: whether a hand may have it: guard, press control and simulated hand place contacts in closed form.
        in_tasks: of a surface, whether the tasks may have it: they roll objects round a finger of one radius.
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
"""What ``[surface] kind`` may be."""

INDENTERS: Final = {
    "sphere": Kind("Sphere", {"radius_m": "the sphere's radius [m]"}, on_hand=True),
    "flat": Kind("FlatPunch", {"radius_m": "the punch's radius [m]"}),
    "mesh": Kind("MeshIndenter", mesh=True),
}
"""What ``[indenter] kind`` may be."""


def named(kinds: Mapping[str, Kind], attribute: str) -> str:
    """Return the names of the kinds of which an attribute is true, as words of a message."""
    return " or ".join(f'"{name}"' for name, kind in kinds.items() if getattr(kind, attribute))
