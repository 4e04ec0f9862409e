"""Rolled objects: their shape, mass and indenter."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar, Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from skincal.envs.drawing import Values, number
from skincal.model import Contacts, Indenter, MeshIndenter, Sphere
from skincal.model.arrays import FloatArray
from skincal.tasks import ObjectName


@dataclass(frozen=True)
class Part:
    """A round part of a body: a ball, or a cylinder along +x of the body's frame.

    Attributes:
        length_m: of the cylinder [m]; None: a ball.
        at_m: its centre on the body's x axis [m].
    """

    radius_m: float
    length_m: float | None = None
    at_m: float = 0.0


@dataclass(frozen=True)
class Body(ABC):
    """A rigid body; its frame has its origin at the centre of mass.

    Attributes:
        kind: name in ranges.
        radius_m: radius of the part that the fingers hold [m].
    """

    kind: ClassVar[ObjectName]
    radius_m: float
    mass_kg: float

    @property
    @abstractmethod
    def parts(self) -> tuple[Part, ...]:
        """Return the collision shapes."""

    @abstractmethod
    def look(self, engine: Any) -> int:
        """Return a visual shape in a client of PyBullet."""

    @property
    @abstractmethod
    def inertia_kg_m2(self) -> tuple[float, float, float]:
        """Moments of inertia about the axes of its frame [kg m²]."""

    @property
    @abstractmethod
    def indenter(self) -> Indenter:
        """Return the shape that presses on the skin."""

    def contacts(
        self,
        point_m: FloatArray,
        normal: FloatArray,
        force_n: float,
        position_m: FloatArray,
        rotation: FloatArray,
    ) -> Contacts:
        """Return a contact for the skin model; all vectors are in the fingertip frame.

        Args:
            point_m: (3,) where it touches [m].
            normal: (3,) unit normal, out of the fingertip.
            force_n: normal force [N].
            position_m: (3,) the body's origin [m].
            rotation: (3, 3) from the body's frame.
        """
        return Contacts.one(point_m, normal, force_n, rotation, position_m)


@dataclass(frozen=True)
class Marble(Body):
    """A ball, closed form for the skin."""

    kind: ClassVar[ObjectName] = "marble"

    @property
    def parts(self) -> tuple[Part, ...]:
        return (Part(self.radius_m),)

    def look(self, engine: Any) -> int:
        return engine.createVisualShape(engine.GEOM_SPHERE, radius=self.radius_m, rgbaColor=_MARBLE_COLOUR)

    @property
    def inertia_kg_m2(self) -> tuple[float, float, float]:
        moment = 0.4 * self.mass_kg * self.radius_m**2
        return moment, moment, moment

    @property
    def indenter(self) -> Indenter:
        return Sphere(self.radius_m)

    def contacts(
        self,
        point_m: FloatArray,
        normal: FloatArray,
        force_n: float,
        position_m: FloatArray,
        rotation: FloatArray,
    ) -> Contacts:
        """See :meth:`Body.contacts`. The ball touches where its centre is nearest, however it is turned."""
        del point_m, rotation
        return Contacts.one(position_m - self.radius_m * normal, normal, force_n)


_MARBLE_COLOUR = (0.15, 0.35, 0.75, 1.0)
_BOLT_COLOUR = (0.75, 0.45, 0.15, 1.0)


@dataclass(frozen=True)
class Bolt(Body):
    """A bolt along +x of its frame, the head in front: M12 x 70 with a hexagon head, if its radius is 6 mm.

    The paper says no more than the radius; the other lengths are those of ISO 4014, in proportion to it. The mass of
    5 g to 7 g (the paper's) is that of a printed one. No thread.
    """

    kind: ClassVar[ObjectName] = "bolt"
    _SHANK = 70.0 / 6.0
    _FLATS = 18.0 / 6.0
    _HEAD = 7.5 / 6.0

    @property
    def shank_m(self) -> float:
        """Length of the shank [m]."""
        return self._SHANK * self.radius_m

    @property
    def head_m(self) -> float:
        """Height of the head [m]."""
        return self._HEAD * self.radius_m

    @property
    def head_radius_m(self) -> float:
        """Half the width of the head across its flats [m]."""
        return self._FLATS * self.radius_m / 2

    @property
    def behind_m(self) -> float:
        """From the end of the shank to the centre of mass [m]."""
        shank, head = self._volumes
        middle = self.shank_m + self.head_m / 2
        return (shank * self.shank_m / 2 + head * middle) / (shank + head)

    @property
    def _volumes(self) -> tuple[float, float]:
        shank = math.pi * self.radius_m**2 * self.shank_m
        return shank, 2 * math.sqrt(3) * self.head_radius_m**2 * self.head_m

    @property
    def inertia_kg_m2(self) -> tuple[float, float, float]:
        """See :attr:`Body.inertia_kg_m2`. The head as a cylinder of its volume."""
        along = across = 0.0
        for volume, part in zip(self._volumes, self.parts, strict=True):
            assert part.length_m is not None
            mass = self.mass_kg * volume / sum(self._volumes)
            radius_2 = volume / (math.pi * part.length_m)
            along += mass * radius_2 / 2
            across += mass * (radius_2 / 4 + part.length_m**2 / 12 + part.at_m**2)
        return along, across, across

    @property
    def parts(self) -> tuple[Part, ...]:
        """See :attr:`Body.parts`. Two cylinders, so that it rolls evenly; the head as wide as across its flats."""
        return (
            Part(self.radius_m, self.shank_m, self.shank_m / 2 - self.behind_m),
            Part(self.head_radius_m, self.head_m, self.shank_m + self.head_m / 2 - self.behind_m),
        )

    def look(self, engine: Any) -> int:
        vertices, faces = self.mesh()
        mesh = {"vertices": vertices.tolist(), "indices": faces.ravel().tolist()}
        return engine.createVisualShape(engine.GEOM_MESH, **mesh, rgbaColor=_BOLT_COLOUR)

    def mesh(self) -> tuple[FloatArray, NDArray[np.int64]]:
        """Return vertices (V, 3) [m] and faces (F, 3): shank and head, each closed."""
        shank = _prism(self.radius_m, 96, 0.0, self.shank_m + self.head_m / 2)
        corner_m = self.head_radius_m * 2 / math.sqrt(3)
        head = _prism(corner_m, 6, self.shank_m, self.shank_m + self.head_m)
        vertices = np.concatenate([shank[0], head[0]]) - [self.behind_m, 0.0, 0.0]
        return vertices, np.concatenate([shank[1], head[1] + len(shank[0])])

    @property
    def indenter(self) -> Indenter:
        """See :attr:`Body.indenter`. Its ray structure is built once for each radius."""
        return _bolt_indenter(self.radius_m)


BODIES: Final[dict[ObjectName, type[Body]]] = {one.kind: one for one in (Marble, Bolt)}
"""Bodies by their name in ranges."""


def body_of(kind: ObjectName, values: Values) -> Body:
    """Return the object of an episode."""
    return BODIES[kind](*(number(values, f"object.{kind}.{name}") for name in ("radius_m", "mass_kg")))


def turn_of(kind: ObjectName, values: Values, orientation_deg: float) -> FloatArray:
    """Return the object's initial rotation (3, 3) in the fingertip's frame; the identity for a ball."""
    if kind == "marble":
        return np.eye(3)
    psi, theta, phi = (number(values, f"object.{kind}.{name}_deg") for name in ("psi", "theta", "phi"))
    return Rotation.from_euler("ZYX", [orientation_deg + psi, theta, phi], degrees=True).as_matrix()


@lru_cache(maxsize=8)
def _bolt_indenter(radius_m: float) -> MeshIndenter:
    return MeshIndenter(*Bolt(radius_m, 1.0).mesh())


def _prism(radius_m: float, sides: int, start_m: float, end_m: float) -> tuple[FloatArray, NDArray[np.int64]]:
    """Return a closed prism along +x with its corners on a circle."""
    angle = 2 * np.pi * np.arange(sides) / sides
    ring = radius_m * np.stack([np.zeros(sides), np.cos(angle), np.sin(angle)], axis=1)
    ends = np.array([[start_m, 0.0, 0.0], [end_m, 0.0, 0.0]])
    vertices = np.concatenate([ring + ends[0], ring + ends[1], ends])
    i, j = np.arange(sides), np.roll(np.arange(sides), -1)
    low, high = np.full(sides, 2 * sides), np.full(sides, 2 * sides + 1)
    faces = [[i, j, sides + j], [i, sides + j, sides + i], [low, j, i], [high, sides + i, sides + j]]
    return vertices, np.concatenate([np.stack(face, axis=1) for face in faces]).astype(np.int64)
