"""Shapes and a plain reading of the paper that the model's tests share."""

from __future__ import annotations

import numpy as np
import trimesh
from published import RADIUS_M

from skincal.model import Contacts, FlatPunch, Indenter, MeshIndenter, MeshSurface, Patch, SensorPose, Sphere

POSE = SensorPose(y_m=0.0235, alpha_rad=0.3, beta_rad=0.1)


def cylinder_mesh(sections: int, *, open_base: bool = False) -> trimesh.Trimesh:
    """A finger of the paper's radius from y = -10 to 70 mm."""
    mesh = trimesh.creation.cylinder(radius=RADIUS_M, height=0.08, sections=sections)
    mesh = trimesh.Trimesh(mesh.vertices[:, [1, 2, 0]] + [0.0, 0.03, 0.0], mesh.faces, process=False)
    if open_base:
        mesh.update_faces(mesh.triangles_center[:, 1] > -0.0099)
    return mesh


def surface_of(mesh: trimesh.Trimesh, **options: float) -> MeshSurface:
    return MeshSurface(mesh.vertices, mesh.faces, **options)


def sphere_mesh(subdivisions: int, radius_m: float = 0.006) -> MeshIndenter:
    """A ball that touches the origin from above."""
    mesh = trimesh.creation.icosphere(subdivisions, radius=radius_m)
    return MeshIndenter(mesh.vertices + np.array([0.0, 0.0, radius_m]), mesh.faces)


def bolt_mesh() -> MeshIndenter:
    """A shaft along x that lies on the origin, with a hexagonal head at x = 10 mm that reaches lower: not convex."""
    shaft = trimesh.creation.cylinder(radius=0.003, height=0.02, sections=48)
    head = trimesh.creation.cylinder(radius=0.005, height=0.004, sections=6).apply_translation([0, 0, 0.012])
    both = trimesh.util.concatenate([shaft, head])
    return MeshIndenter(both.vertices[:, [2, 1, 0]] + [0.0, 0.0, 0.003], both.faces)


def box_mesh() -> MeshIndenter:
    box = trimesh.creation.box((0.01, 0.004, 0.004))
    return MeshIndenter(box.vertices + np.array([0.0, 0.0, 0.002]), box.faces)


def indenters() -> dict[str, Indenter]:
    return {
        "sphere": Sphere(0.006),
        "flat": FlatPunch(0.003),
        "sphere mesh": sphere_mesh(4),
        "bolt mesh": bolt_mesh(),
        "box mesh": box_mesh(),
    }


def plain_cast(
    indenter: Indenter, origins: np.ndarray, direction: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Distances (N,), inf where it is missed, and facing (N,) of an indenter by its equation; meshes cast their own."""
    if isinstance(indenter, Sphere):
        away = origins - [0.0, 0.0, indenter.radius_m]
        half_2 = (away @ direction) ** 2 - np.sum(away**2, axis=1) + indenter.radius_m**2
        half = np.sqrt(np.maximum(half_2, 0.0))
        return np.where(half_2 >= 0, -(away @ direction) - half, np.inf), half / indenter.radius_m
    if isinstance(indenter, FlatPunch):
        distance = -origins[:, 2] / direction[2] if direction[2] else np.full(len(origins), np.inf)
        met = origins + np.where(np.isfinite(distance), distance, 0.0)[:, None] * direction
        hit = np.isfinite(distance) & (np.sum(met**2, axis=1) <= indenter.radius_m**2)
        return np.where(hit, distance, np.inf), np.where(hit, abs(direction[2]), 0.0)
    hits = indenter.cast(origins, direction)
    return hits.distance_m, hits.facing


def plain_loads(
    patch: Patch, indenter: Indenter, contacts: Contacts, elasticity_pa_per_m: float
) -> np.ndarray:
    """The paper's model as printed: every point is cast, and the penetration is found by bisection."""
    loads = np.zeros((len(contacts), patch.layout.taxels))
    for k in range(len(contacts)):
        normal, rotation = contacts.normals[k], contacts.indenter_rotations[k]
        origins = (patch.points_m - contacts.indenter_origins_m[k]) @ rotation
        distance, facing = plain_cast(indenter, origins, rotation.T @ normal)
        weight = patch.areas_m2 * np.maximum(patch.normals @ normal, 0.0)
        distance = np.where(weight > 0, distance, np.inf)
        if not np.isfinite(distance.min()):
            continue
        gap = distance - distance.min()
        low, high = 0.0, 1e3
        for _ in range(200):
            middle = (low + high) / 2
            too_much = (
                elasticity_pa_per_m * np.sum(np.maximum(middle - gap, 0.0) * weight) > contacts.force_n[k]
            )
            low, high = (low, middle) if too_much else (middle, high)
        load = elasticity_pa_per_m * np.maximum(low - gap, 0.0) * weight * facing
        loads[k] = np.bincount(patch.taxel + 1, load, patch.layout.taxels + 1)[1:]
    return loads
