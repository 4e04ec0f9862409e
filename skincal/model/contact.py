"""Contacts: point, normal and force of a press, and the pose of its indenter."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from skincal.model.arrays import BoolArray, FloatArray, IntArray, check_shape, floats, frozen, unit_rows

_DEGENERATE = 1e-6
"""Shortest projection of an axis onto the tangent plane that still has a direction: a numerical tolerance."""


@dataclass(frozen=True, eq=False)
class Contacts:
    """A batch of K contacts, in the fingertip frame.

    ``rotations`` and ``origins_m`` give the pose of the indenter's frame. Without ``origins_m`` the origin is the
    contact point. Without ``rotations`` the indenter's +z is the contact normal and its +y is the fingertip's +y,
    projected onto the tangent plane; where the normal is parallel to y, its +x is the fingertip's +x. A free object
    (a marble, a bolt) needs both; ``points_m`` then only reports the position of the press.

    NaN in the point, normal or origin of a row marks a press at an unknown position.

    Attributes:
        points_m: (K, 3) contact points [m].
        normals: (K, 3) unit contact normals n_c, out of the fingertip and into the indenter.
        force_n: (K,) normal forces F_n [N], positive when pressing.
        rotations: (K, 3, 3) from the indenter's frame to the fingertip's.
        origins_m: (K, 3) origins of the indenter's frame [m].
    """

    points_m: FloatArray
    normals: FloatArray
    force_n: FloatArray
    rotations: FloatArray | None = None
    origins_m: FloatArray | None = None

    def __post_init__(self) -> None:
        points = floats("contact points_m", self.points_m, (None, 3), finite=False)
        count = len(points)
        normals = unit_rows("contact normals", self.normals, finite=False)
        check_shape("contact normals", normals, (count, 3))
        object.__setattr__(self, "points_m", points)
        object.__setattr__(self, "normals", normals)
        force = floats("contact force_n", self.force_n, (count,), finite=False)
        object.__setattr__(self, "force_n", force)
        if self.rotations is not None:
            object.__setattr__(self, "rotations", _checked_rotations(self.rotations, count))
        if self.origins_m is not None:
            origins = floats("contact origins_m", self.origins_m, (count, 3), finite=False)
            object.__setattr__(self, "origins_m", origins)

    @classmethod
    def one(
        cls,
        point_m: FloatArray,
        normal: FloatArray,
        force_n: float,
        rotation: FloatArray | None = None,
        origin_m: FloatArray | None = None,
    ) -> Contacts:
        """Make one contact without checks, for a simulation whose vectors are known to be valid.

        The arrays are not copied and must not be changed afterwards.

        Args:
            point_m: (3,) [m].
            normal: (3,) unit contact normal.
            force_n: [N].
            rotation: (3, 3) from the indenter's frame to the fingertip's.
            origin_m: (3,) origin of the indenter's frame [m].
        """
        contact = object.__new__(cls)
        contact.__dict__.update(
            points_m=point_m[None],
            normals=normal[None],
            force_n=np.array([force_n]),
            rotations=None if rotation is None else rotation[None],
            origins_m=None if origin_m is None else origin_m[None],
        )
        return contact

    def __len__(self) -> int:
        return len(self.force_n)

    @cached_property
    def indenter_rotations(self) -> FloatArray:
        """(K, 3, 3) rotations from the indenter's frame to the fingertip's."""
        return contact_rotations(self.normals) if self.rotations is None else self.rotations

    @property
    def indenter_origins_m(self) -> FloatArray:
        """(K, 3) origins of the indenter's frame [m]."""
        return self.points_m if self.origins_m is None else self.origins_m

    @property
    def known(self) -> BoolArray:
        """(K,) True where the force, point, normal, origin and rotation are finite."""
        # Default rotations follow from the normals and need no check.
        places = [self.points_m, self.normals]
        places += [] if self.origins_m is None else [self.origins_m]
        places += [] if self.rotations is None else [self.rotations.reshape(-1, 9)]
        finite: BoolArray = np.isfinite(np.concatenate([self.force_n[:, None], *places], axis=1))
        return np.logical_and.reduce(finite, axis=1)

    def __getitem__(self, rows: slice | IntArray | BoolArray) -> Contacts:
        """Return a subset of the contacts."""
        return Contacts(
            self.points_m[rows],
            self.normals[rows],
            self.force_n[rows],
            None if self.rotations is None else self.rotations[rows],
            None if self.origins_m is None else self.origins_m[rows],
        )


def contact_rotations(normals: ArrayLike) -> FloatArray:
    """Return the default rotations of indenters, with +z along the contact normal.

    Args:
        normals: (K, 3) unit contact normals.

    Returns:
        (K, 3, 3) right-handed rotations; their columns are the axes of the indenter's frame. +y is the fingertip's
        +y projected onto the tangent plane. Where the normal is parallel to y, +x is the fingertip's +x.
    """
    z = np.asarray(normals, dtype=np.float64)
    y = -z[:, 1:2] * z
    y[:, 1] += 1.0
    length = np.sqrt(np.einsum("ki,ki->k", y, y))
    at_tip = length < _DEGENERATE
    if at_tip.any():
        y[at_tip] = np.cross(z[at_tip], [1.0, 0.0, 0.0])
        length[at_tip] = np.sqrt(np.einsum("ki,ki->k", y[at_tip], y[at_tip]))
    y /= length[:, None]
    rotations = np.empty((len(z), 3, 3))
    for k, i, j in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        rotations[:, k, 0] = y[:, i] * z[:, j] - y[:, j] * z[:, i]
    rotations[:, :, 1], rotations[:, :, 2] = y, z
    return rotations


def _checked_rotations(rotations: ArrayLike, count: int) -> FloatArray:
    """Return checked rotations (K, 3, 3); rows with NaN pass."""
    matrices = floats("contact rotations", rotations, (count, 3, 3), finite=False)
    skew = np.abs(np.swapaxes(matrices, 1, 2) @ matrices - np.eye(3)).max(axis=(1, 2), initial=0.0)
    bad = np.flatnonzero((skew > 1e-6) | (np.linalg.det(matrices) < 0))
    if bad.size:
        raise ValueError(
            f"contact rotations: expected right-handed rotation matrices; got none in row {bad[0]}"
        )
    return frozen(matrices)
