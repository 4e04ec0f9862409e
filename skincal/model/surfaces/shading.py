"""Smooth normals on a mesh that stands for a smooth surface."""

from __future__ import annotations

import numpy as np

from skincal.model.arrays import FloatArray, IntArray
from skincal.model.mesh import TriangleMesh

_FAN = 256
"""At a vertex with more faces (the hub of a disc) each keeps its own normal: pairs grow as the square."""


def corner_normals(mesh: TriangleMesh, crease_rad: float) -> FloatArray:
    """Return a normal for each corner of each face, averaged over the faces that continue it smoothly.

    At a corner the normals of the faces round the vertex are added, each with its angle there as weight, as far
    as they differ from the corner's own face by less than ``crease_rad``. Linear interpolation over a face then
    gives normals with an error that falls with the square of the mesh's size; a real edge stays an edge.

    Args:
        mesh: wound consistently.
        crease_rad: angle between faces from which on an edge is real [rad].

    Returns:
        (F, 3, 3) unit normals: face, corner, component.
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
