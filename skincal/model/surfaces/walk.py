"""Geodesics on a mesh, along which a patch is mapped onto it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skincal.model.arrays import BoolArray, FloatArray, IntArray
from skincal.model.mesh import TriangleMesh

_FAN = 256
"""Largest number of faces at a vertex whose normals are averaged: the number of pairs grows as the square. At a vertex
with more faces (the hub of a disc) each face keeps its own normal."""


def corner_normals(mesh: TriangleMesh, crease_rad: float) -> FloatArray:
    """Return a unit normal for each corner of each face (F, 3, 3), averaged over smoothly adjoining faces.

    The average is over the faces at the vertex whose normals differ from the corner's own face by less than
    ``crease_rad``, weighted by their angles at the vertex. Linear interpolation over a face then gives normals whose
    error falls with the square of the edge length; sharp edges stay sharp.

    Args:
        mesh: a mesh with consistent winding.
        crease_rad: smallest angle between faces at a sharp edge [rad].
    """
    vertex, weight = mesh.faces.ravel(), _corner_angles(mesh).ravel()
    first, second = _corner_pairs(vertex)
    own, other = first // 3, second // 3
    smooth = np.einsum("ij,ij->i", mesh.normals[own], mesh.normals[other]) > np.cos(crease_rad)
    first, second, other = first[smooth], second[smooth], other[smooth]
    total = np.stack(
        [
            np.bincount(first, weight[second] * mesh.normals[other, k], minlength=len(vertex))
            for k in range(3)
        ],
        axis=1,
    )
    alone = np.bincount(first, minlength=len(vertex)) == 0
    total[alone] = np.repeat(mesh.normals, 3, axis=0)[alone]
    return (total / np.linalg.norm(total, axis=1, keepdims=True)).reshape(-1, 3, 3)


def interpolated(mesh: TriangleMesh, corners: FloatArray, face: IntArray, points_m: FloatArray) -> FloatArray:
    """Return unit normals (N, 3) at points (N, 3) of faces (N,), interpolated between corner normals (F, 3, 3)."""
    a, b, c = (mesh.vertices_m[mesh.faces[face, i]] for i in range(3))
    normal, doubled = mesh.normals[face], 2 * mesh.areas_m2[face]
    share_b = np.einsum("ij,ij->i", np.cross(points_m - a, c - a), normal) / doubled
    share_c = np.einsum("ij,ij->i", np.cross(b - a, points_m - a), normal) / doubled
    share = np.maximum(np.stack([1 - share_b - share_c, share_b, share_c], axis=1), 0.0)
    mixed = np.einsum("ij,ijk->ik", share, corners[face])
    return mixed / np.linalg.norm(mixed, axis=1, keepdims=True)


def _corner_angles(mesh: TriangleMesh) -> FloatArray:
    """Return the inner angles of the faces (F, 3) [rad]."""
    corner = mesh.vertices_m[mesh.faces]
    to_next = np.roll(corner, -1, axis=1) - corner
    to_last = np.roll(corner, 1, axis=1) - corner
    cross = np.linalg.norm(np.cross(to_next, to_last), axis=2)
    return np.arctan2(cross, np.sum(to_next * to_last, axis=2))


def _corner_pairs(vertex: IntArray) -> tuple[IntArray, IntArray]:
    """Return all ordered pairs of corners that share a vertex with at most ``_FAN`` corners."""
    order = np.argsort(vertex, kind="stable")
    _, start, count = np.unique(vertex[order], return_index=True, return_counts=True)
    keep = count <= _FAN
    start, count = start[keep], count[keep]
    size = np.repeat(count, count)
    first = np.repeat(start, count) + _concatenated_ranges(count)
    return order[np.repeat(first, size)], order[
        np.repeat(np.repeat(start, count), size) + _concatenated_ranges(size)
    ]


def _concatenated_ranges(lengths: IntArray) -> IntArray:
    """Return ``arange(length)`` of each length, concatenated."""
    ends = np.cumsum(lengths)
    return np.arange(ends[-1] if len(ends) else 0) - np.repeat(ends - lengths, lengths)


_REACH = 2.0
"""Search distance above and below the tangent plane of a step, in step lengths."""


@dataclass(frozen=True, eq=False)
class Stand:
    """W positions on a mesh with headings; NaN where a walk has left the mesh.

    Attributes:
        points_m: (W, 3) [m].
        normals: (W, 3) outward unit normals.
        heading: (W, 3) unit vectors in the tangent plane.
    """

    points_m: FloatArray
    normals: FloatArray
    heading: FloatArray

    def __getitem__(self, rows: IntArray | BoolArray) -> Stand:
        """Return a subset of the positions."""
        return Stand(self.points_m[rows], self.normals[rows], self.heading[rows])

    def turned_right(self) -> Stand:
        """Return the same positions with headings turned to the right, from v to u."""
        return Stand(self.points_m, self.normals, np.cross(self.heading, self.normals))


@dataclass(frozen=True, eq=False)
class Walker:
    """Follows geodesics on a mesh in short steps.

    A step goes along the heading in the tangent plane, and returns to the mesh by a ray along the normal at its start.
    The heading is parallel transported: it only turns with the normal. The length of a walk is the sum of its chords.
    On a curve of radius R the relative error of a step h is h² / 24 R².

    Attributes:
        mesh: the surface.
        corners: (F, 3, 3) normals at the corners of its faces.
        step_m: step length h [m].
    """

    mesh: TriangleMesh
    corners: FloatArray
    step_m: float

    def walk(self, start: Stand, walker: IntArray, length_m: FloatArray) -> Stand:
        """Return the M ends of walks of given lengths; NaN where a walk leaves the mesh.

        Args:
            start: W starting positions.
            walker: (M,) index of each walk's starting position.
            length_m: (M,) lengths [m], zero or more.
        """
        ends = _nan_stand(len(walker))
        walked = np.zeros(len(start.points_m))
        furthest = np.full(len(walked), -np.inf)
        np.maximum.at(furthest, walker, length_m)
        open_ = np.ones(len(walker), dtype=np.bool_)
        here = start
        while True:
            going = np.flatnonzero((walked <= furthest) & np.isfinite(here.points_m[:, 0]))
            if not going.size:
                return ends
            there = _set_rows(_nan_stand(len(walked)), going, self.step(here[going], self.step_m))
            chord = np.linalg.norm(there.points_m - here.points_m, axis=1)
            # A walk that leaves the mesh in this step can still have ends before the edge.
            stride = np.where(np.isnan(chord), self.step_m, chord)
            due = np.flatnonzero(
                open_ & (length_m < (walked + stride)[walker]) & np.isfinite(here.points_m[walker, 0])
            )
            at = walker[due]
            part = (length_m[due] - walked[at]) * self.step_m / stride[at]
            ends = _set_rows(ends, due, self.step(here[at], part))
            open_[due] = False
            walked += stride
            here = there

    def step(self, here: Stand, length_m: float | FloatArray) -> Stand:
        """Take one step along the heading; NaN where there is no mesh below its end.

        Args:
            here: W positions.
            length_m: length of the step in the tangent plane [m], one or (W,).
        """
        ahead = np.broadcast_to(np.asarray(length_m, dtype=np.float64), (len(here.points_m),))[:, None]
        clear = _REACH * self.step_m
        above = here.points_m + ahead * here.heading + clear * here.normals
        face, drop = self.mesh.first_hit(above, -here.normals)
        lost = (face < 0) | (drop > 2 * clear)
        points = above - np.where(lost, np.nan, drop)[:, None] * here.normals
        normals = self.normals(face, points, -here.normals)
        heading = _transported(here.heading, here.normals, normals)
        return Stand(points, np.where(lost[:, None], np.nan, normals), heading)

    def normals(self, face: IntArray, points_m: FloatArray, against: FloatArray) -> FloatArray:
        """Return smooth normals (N, 3) at points of faces, oriented against the directions ``against`` (N, 3)."""
        normals = interpolated(self.mesh, self.corners, face, points_m)
        return normals * -np.sign(np.einsum("ij,ij->i", normals, against))[:, None]


def _transported(heading: FloatArray, old: FloatArray, new: FloatArray) -> FloatArray:
    """Rotate headings (W, 3) by the smallest rotation from the old normals to the new ones."""
    along = np.einsum("ij,ij->i", heading, new) / (1 + np.einsum("ij,ij->i", old, new))
    turned = heading - along[:, None] * (old + new)
    return turned / np.linalg.norm(turned, axis=1, keepdims=True)


def _nan_stand(count: int) -> Stand:
    return Stand(*(np.full((count, 3), np.nan) for _ in range(3)))


def _set_rows(into: Stand, rows: IntArray, values: Stand) -> Stand:
    for name in ("points_m", "normals", "heading"):
        getattr(into, name)[rows] = getattr(values, name)
    return into
