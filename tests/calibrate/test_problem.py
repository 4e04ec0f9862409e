"""Choice of the solver for a dataset, and fits on a mesh."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from commands import captured

from benchmarks.sessions import Truth, make_session
from skincal.calibrate import Way, calibrate, choose_way, fit_problem, search_box
from skincal.dataset import Dataset, SurfaceSpec, write_dataset
from skincal.errors import InputError, WorkError
from skincal.fitting.fit_options import FitOptions, GridSteps
from skincal.model import Cylinder
from skincal.units import deg
from tests.fitting.conftest import QUICK
from tests.fitting.geometry import shell_arrays

RADIUS = 0.0115


@pytest.fixture(scope="module")
def cylinder() -> tuple[Dataset, Truth]:
    return make_session(np.random.default_rng(7), presses=26)


@pytest.fixture(scope="module")
def mesh(cylinder: tuple[Dataset, Truth]) -> Dataset:
    """The same session, told to lie on a mesh of the cylinder."""
    session, _ = cylinder
    arrays = shell_arrays(lambda y: np.full_like(y, RADIUS), 128, 60)
    file = trimesh.Trimesh(*arrays, process=False).export(file_type="stl")
    meta = replace(session.meta, surface=SurfaceSpec("mesh", None, "tip.stl"))
    return replace(session, meta=meta, meshes={"tip.stl": file})


def _with_normals(session: Dataset, normals: np.ndarray) -> Dataset:
    return replace(session, presses=replace(session.presses, normals=normals))


def test_a_cylinder_goes_the_fast_way_unless_reported_otherwise(cylinder: tuple[Dataset, Truth]) -> None:
    session, _ = cylinder
    assert choose_way(session) == Way("fast")
    assert choose_way(session, "nlopt").method == "nlopt"


def test_a_mesh_goes_the_general_way_and_says_why(mesh: Dataset) -> None:
    way = choose_way(mesh)
    assert way.method == "general"
    assert "mesh" in way.why
    with pytest.raises(InputError, match="expected auto or general"):
        choose_way(mesh, "fast")


def test_an_unknown_method_is_refused(cylinder: tuple[Dataset, Truth]) -> None:
    with pytest.raises(InputError, match="one of auto, fast, general, nlopt"):
        choose_way(cylinder[0], "gradient")  # type: ignore[arg-type]


def test_normals_that_are_the_surface_s_own_change_nothing(cylinder: tuple[Dataset, Truth]) -> None:
    session, _ = cylinder
    rng = np.random.default_rng(0)
    surface, points = Cylinder(RADIUS), session.presses.position_m
    own = surface.normal_at(points)
    assert choose_way(_with_normals(session, own)).method == "fast"
    # Normals of where the contact really was, while the position is off by what the rig's is worth.
    true = surface.normal_at(surface.offset(points, rng.normal(0, 0.8e-3, len(points)), 0.0))
    assert choose_way(_with_normals(session, true)).method == "fast"
    own[3:] = np.nan
    assert choose_way(_with_normals(session, own)).method == "fast"


def test_tilted_normals_go_the_general_way(cylinder: tuple[Dataset, Truth]) -> None:
    session, _ = cylinder
    own = Cylinder(RADIUS).normal_at(session.presses.position_m)
    tilted = own + np.array([0.0, math.tan(math.radians(8.0)), 0.0])
    tilted /= np.linalg.norm(tilted, axis=1, keepdims=True)
    way = choose_way(_with_normals(session, tilted))
    assert way.method == "general"
    assert "8.0°" in way.why
    problem = fit_problem(_with_normals(session, tilted), FitOptions(), way)
    assert problem.contacts is not None and problem.contacts.measured_normals
    _, normals = problem.contacts.at(problem.rows, np.full((len(problem), 2), 1e-3))
    assert normals == pytest.approx(tilted[problem.rows], abs=1e-6)


def test_a_mesh_is_searched_by_its_radius_at_the_sensor(
    cylinder: tuple[Dataset, Truth], mesh: Dataset
) -> None:
    few = mesh.presses.select(np.arange(8))
    problem = fit_problem(replace(mesh, presses=few), FitOptions())
    assert problem.contacts is not None
    assert problem.rig.arc_radius_m == pytest.approx(RADIUS, rel=1e-3)
    plain = fit_problem(replace(cylinder[0], presses=few), FitOptions())
    assert plain.contacts is None
    assert problem.across_m == pytest.approx(plain.across_m, abs=1e-5)
    assert search_box(mesh).across_m == pytest.approx(search_box(cylinder[0]).across_m, rel=1e-3)


def test_a_nominal_pose_off_the_mesh_is_said(mesh: Dataset) -> None:
    meta = replace(mesh.meta, mount=replace(mesh.meta.mount, y_m=0.4, y_range_m=(0.39, 0.41)))
    with pytest.raises(WorkError, match=r"nominal pose in \[mount\]"):
        fit_problem(replace(mesh, meta=meta), FitOptions())


def test_the_command_refuses_a_method_that_cannot_be_used(
    tmp_path: Path, mesh: Dataset, capsys: pytest.CaptureFixture[str]
) -> None:
    write_dataset(mesh, tmp_path / "session")
    status, _, err = captured(
        capsys, "fit", tmp_path / "session", "--out", tmp_path / "cal", "--method", "fast"
    )
    assert status == 2 and "--method: expected" in err
    assert not (tmp_path / "cal").exists()


@pytest.mark.slow
def test_a_session_on_a_mesh_is_fitted(cylinder: tuple[Dataset, Truth], mesh: Dataset) -> None:
    told = cylinder[1].as_positions_tell
    options = replace(QUICK, steps=GridSteps(2.5e-3, 2.5e-3, math.radians(20), 3))
    stages: list[str] = []
    outcome = calibrate(mesh, options=options, progress=lambda stage, _done, _total: stages.append(stage))
    assert outcome.way.method == "general"
    calibration = outcome.calibration
    for name in calibration.model.best():
        low, high = calibration.intervals[name]
        assert low <= getattr(told, name) <= high, name
    low, high = calibration.intervals["beta_deg"]
    assert high - low < deg(2e-3 / RADIUS)
    assert calibration.provenance.options["method"] == "general"
    assert "grid" in stages and "draws" in stages
    used = np.asarray(calibration.slack["used"])
    points = np.column_stack([calibration.slack[name] for name in ("x_m", "y_m", "z_m")])[used]
    assert np.hypot(points[:, 0], points[:, 2]) == pytest.approx(np.full(len(points), RADIUS), abs=2e-5)
    json.dumps(calibration.model.best())
