"""Straight walks on a mesh: how a patch is laid on it like a cloth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skincal.model.arrays import BoolArray, FloatArray, IntArray
from skincal.model.mesh import TriangleMesh

_FAN = 256
"""At a vertex with more faces (the hub of a disc) each keeps its own normal: pairs grow as the square."""


def corner_normals(mesh: TriangleMesh, crease_rad: float) -> FloatArray:
    """Return a unit normal of each corner of each face (F, 3, 3), averaged over the faces that continue it smoothly.

    At a corner the normals of the faces round the vertex are added, each with its angle there as weight, as far
    as they differ from the corner's own face by less than ``crease_rad``. Linear interpolation over a face then
    gives normals with an error that falls with the square of the mesh's size; a real edge stays an edge.

    Args:
        mesh: wound consistently.
        crease_rad: angle between faces from which on an edge is real [rad].
    """
    vertex, weight = mesh.faces.ravel(), _corner_angles(mesh).ravel()
    first, second = _pairs(vertex)
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
    """Return unit normals (N, 3) at points (N, 3) of faces (N,), linear between the corners' normals (F, 3, 3)."""
    a, b, c = (mesh.vertices_m[mesh.faces[face, i]] for i in range(3))
    normal, doubled = mesh.normals[face], 2 * mesh.areas_m2[face]
    share_b = np.einsum("ij,ij->i", np.cross(points_m - a, c - a), normal) / doubled
    share_c = np.einsum("ij,ij->i", np.cross(b - a, points_m - a), normal) / doubled
    share = np.maximum(np.stack([1 - share_b - share_c, share_b, share_c], axis=1), 0.0)
    mixed = np.einsum("ij,ijk->ik", share, corners[face])
    return mixed / np.linalg.norm(mixed, axis=1, keepdims=True)


def _corner_angles(mesh: TriangleMesh) -> FloatArray:
    """Return inner angles (F, 3) [rad]."""
    corner = mesh.vertices_m[mesh.faces]
    to_next = np.roll(corner, -1, axis=1) - corner
    to_last = np.roll(corner, 1, axis=1) - corner
    cross = np.linalg.norm(np.cross(to_next, to_last), axis=2)
    return np.arctan2(cross, np.sum(to_next * to_last, axis=2))


def _pairs(vertex: IntArray) -> tuple[IntArray, IntArray]:
    """Return all ordered pairs of corners that share a vertex, but not at vertices with too many."""
    order = np.argsort(vertex, kind="stable")
    _, start, count = np.unique(vertex[order], return_index=True, return_counts=True)
    keep = count <= _FAN
    start, count = start[keep], count[keep]
    size = np.repeat(count, count)
    first = np.repeat(start, count) + _counting(count)
    return order[np.repeat(first, size)], order[np.repeat(np.repeat(start, count), size) + _counting(size)]


def _counting(lengths: IntArray) -> IntArray:
    """Return 0, 1, ... up to each length, one after the other."""
    ends = np.cumsum(lengths)
    return np.arange(ends[-1] if len(ends) else 0) - np.repeat(ends - lengths, lengths)


_REACH = 2.0
"""A step looks for the surface this many step lengths above and below its tangent plane."""


@dataclass(frozen=True, eq=False)
class Stand:
    """Places on a mesh and a heading at each; NaN where there is none.

    Attributes:
        points_m: (W, 3) [m].
        normals: (W, 3) outward unit normals.
        heading: (W, 3) unit vectors in the tangent plane.
    """

    points_m: FloatArray
    normals: FloatArray
    heading: FloatArray

    def __getitem__(self, rows: IntArray | BoolArray) -> Stand:
        """Return some of the places."""
        return Stand(self.points_m[rows], self.normals[rows], self.heading[rows])

    def turned_right(self) -> Stand:
        """Return the same places, heading to the right: u where the heading was v."""
        return Stand(self.points_m, self.normals, np.cross(self.heading, self.normals))


@dataclass(frozen=True, eq=False)
class Walker:
    """Walks geodesics on a mesh in short steps.

    A step goes along the heading in the tangent plane and back to the mesh by a ray along the normal it started
    with; the heading is then turned with the normal, and in no other way (parallel transport). Lengths are those
    walked on the mesh, as the sum of chords. On a curve of radius R a step h is too short by h² / 24 R² of itself.

    Attributes:
        mesh: the surface.
        corners: (F, 3, 3) normals at the corners of its faces.
        step_m: h [m].
    """

    mesh: TriangleMesh
    corners: FloatArray
    step_m: float

    def walk(self, start: Stand, walker: IntArray, length_m: FloatArray) -> Stand:
        """Return the M ends of walks of given lengths; NaN where a walk leaves the mesh.

        Args:
            start: W places to start from.
            walker: (M,) which of them each walk starts from.
            length_m: (M,) lengths [m], zero or more.
        """
        ends = _nowhere(len(walker))
        walked = np.zeros(len(start.points_m))
        furthest = np.full(len(walked), -np.inf)
        np.maximum.at(furthest, walker, length_m)
        open_ = np.ones(len(walker), dtype=np.bool_)
        here = start
        while True:
            going = np.flatnonzero((walked <= furthest) & np.isfinite(here.points_m[:, 0]))
            if not going.size:
                return ends
            there = _put(_nowhere(len(walked)), going, self.step(here[going], self.step_m))
            chord = np.linalg.norm(there.points_m - here.points_m, axis=1)
            # A walker about to leave the mesh still serves the ends that lie on it.
            stride = np.where(np.isnan(chord), self.step_m, chord)
            due = np.flatnonzero(
                open_ & (length_m < (walked + stride)[walker]) & np.isfinite(here.points_m[walker, 0])
            )
            at = walker[due]
            part = (length_m[due] - walked[at]) * self.step_m / stride[at]
            ends = _put(ends, due, self.step(here[at], part))
            open_[due] = False
            walked += stride
            here = there

    def step(self, here: Stand, length_m: float | FloatArray) -> Stand:
        """Take one step along the heading; NaN where there is no mesh under its end.

        Args:
            here: W places.
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
        """Return smooth normals (N, 3) at points of faces, on the side that faces against ``against`` (N, 3)."""
        normals = interpolated(self.mesh, self.corners, face, points_m)
        return normals * -np.sign(np.einsum("ij,ij->i", normals, against))[:, None]


def _transported(heading: FloatArray, old: FloatArray, new: FloatArray) -> FloatArray:
    """Turn headings (W, 3) by the smallest rotation that takes the old normals to the new."""
    along = np.einsum("ij,ij->i", heading, new) / (1 + np.einsum("ij,ij->i", old, new))
    turned = heading - along[:, None] * (old + new)
    return turned / np.linalg.norm(turned, axis=1, keepdims=True)


def _nowhere(count: int) -> Stand:
    return Stand(*(np.full((count, 3), np.nan) for _ in range(3)))


def _put(into: Stand, rows: IntArray, values: Stand) -> Stand:
    for name in ("points_m", "normals", "heading"):
        getattr(into, name)[rows] = getattr(values, name)
    return into
