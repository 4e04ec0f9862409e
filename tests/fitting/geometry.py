"""Surfaces and problems for the general way of the fit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from skincal.fitting.general_skin import TABLE_MARGIN_M, ContactMap
from skincal.fitting.problem import FitProblem, PressTable, build_problem
from skincal.model import Cylinder, MeshSurface, Surface
from tests.fitting.conftest import RADIUS, rig


def shell(radius_m: Callable[[np.ndarray], np.ndarray], around: int = 128, along: int = 60) -> MeshSurface:
    """A finger of revolution as a mesh, open at both ends; its radius is a function of y."""
    vertices, faces = shell_arrays(radius_m, around, along)
    return MeshSurface(vertices, faces)


def shell_arrays(
    radius_m: Callable[[np.ndarray], np.ndarray], around: int, along: int
) -> tuple[np.ndarray, np.ndarray]:
    turn = np.linspace(-np.pi, np.pi, around + 1)[:-1, None]
    y = np.linspace(0.0, 0.05, along)
    r = radius_m(y)
    vertices = np.stack([np.sin(turn) * r, np.ones_like(turn) * y, np.cos(turn) * r], axis=-1).reshape(-1, 3)
    i, j = (a.ravel() for a in np.meshgrid(np.arange(around), np.arange(along - 1), indexing="ij"))
    a, b = i * along + j, (i + 1) % around * along + j
    faces = np.concatenate([np.stack([a, a + 1, b], axis=1), np.stack([a + 1, b + 1, b], axis=1)])
    return vertices, faces


def on_cylinder(table: PressTable) -> np.ndarray:
    """Measured contact points (K, 3) of a session on the cylinder."""
    beta = table.across_m / RADIUS
    return np.stack([RADIUS * np.sin(beta), table.along_m, RADIUS * np.cos(beta)], axis=1)


def general_problem(table: PressTable, surface: Surface | None = None) -> FitProblem:
    """A session on the cylinder, or taken to be on a surface that is nearly one, to be fitted the general way."""
    surface = surface or Cylinder(RADIUS)
    own = replace(
        rig(), surface=surface, nominal_radius_m=RADIUS if isinstance(surface, MeshSurface) else None
    )
    problem = build_problem(own, table, min_active=2)
    contacts = ContactMap.of(surface, on_cylinder(table), problem.rows, own.slack_m + TABLE_MARGIN_M)
    return replace(problem, contacts=contacts)
