"""The surface that looks the same everywhere: arc lengths from the nominal centre, and tables that are kept."""

from __future__ import annotations

import numpy as np
import pytest

from skincal.fitting.general_local import LocalPlaces, LocalSurface
from skincal.fitting.general_table import (
    SkinTable,
    TableReach,
    make_table_key,
    split_presses,
    tabulate_presses,
)
from skincal.fitting.problem import FitProblem
from skincal.model import Cylinder, SensorPose
from tests.fitting.conftest import RADIUS, make_session
from tests.fitting.geometry import general_problem, on_cylinder, shell

Y = 0.0238


def cone(y: np.ndarray) -> np.ndarray:
    """A finger that gets thinner towards its tip, by a quarter of the way."""
    return RADIUS - 0.25 * (y - Y)


@pytest.fixture(scope="module")
def problem() -> FitProblem:
    return general_problem(make_session(presses=8)[0])


def test_on_a_cylinder_arcs_are_the_coordinates(problem: FitProblem):
    table = make_session(presses=8)[0]
    local = LocalPlaces.of(problem, on_cylinder(table), np.array([0.0, Y]))
    assert local is not None
    assert local.metric == pytest.approx(np.ones(2), abs=1e-3)
    expected = np.stack([table.across_m, table.along_m], axis=1)
    near = np.abs(expected - [0.0, Y]).max(axis=1) < 12e-3
    assert local.place_m[near] == pytest.approx(expected[near], abs=20e-6)


def test_on_a_cone_arcs_are_longer_than_y():
    surface = shell(cone)
    table = make_session(presses=8)[0]
    problem = general_problem(table, surface)
    uv = np.array([[0.0, 4e-3], [2e-3, -3e-3]])
    points, _ = surface.wrap(SensorPose(Y, 0.0), uv)
    local = LocalPlaces.of(problem, points, np.array([0.0, Y]))
    assert local is not None
    assert local.place_m - [0.0, Y] == pytest.approx(uv, abs=60e-6)
    assert local.metric[1] == pytest.approx(np.hypot(1.0, 0.25), rel=0.01)
    macro = np.array([1e-3, Y + 2e-3, 0.1, 20.0, 4.0])
    assert local.labels(local.arcs(macro)) == pytest.approx(macro)


def test_the_local_surface_ends_with_the_skin():
    local = LocalSurface(Cylinder(RADIUS), SensorPose(Y, 0.0), 5e-3)
    points, normals = local.wrap(SensorPose(0.0, 0.3), np.array([[4e-3, 0.0], [6e-3, 0.0]]))
    assert np.isfinite(points[0]).all()
    assert not np.isfinite(points[1]).any()
    assert not np.isfinite(normals[1]).any()


def test_tables_are_named_by_what_they_depend_on(problem: FitProblem):
    macro = np.array([0.0, Y, 0.0, 20.0, 4.0])
    reach = TableReach(0.2e-3, 0.02, 0.2, levels=2, step_m=1e-3, resolution_m=1e-3)
    parts = split_presses(problem)
    names, again, moved = (
        [make_table_key(problem, part, at, reach) for part in parts]
        for at in (macro, macro.copy(), macro + 1e-5)
    )
    assert names == again
    assert len(set(names)) == len(names)
    assert not set(names) & set(moved)
    assert isinstance(tabulate_presses(problem, parts[0], macro, reach), SkinTable)
