"""A dataset, or a hand, has the sensor of a calibration."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from calibrations import make_calibration

from skincal.calibration import check_same_sensor
from skincal.dataset import SurfaceSpec
from skincal.errors import InputError
from tests.conftest import make_session


def test_the_range_of_an_angle_is_checked_on_a_mesh_too() -> None:
    """The slack of positions is an arc of the mesh's own radius at the calibrated pose."""
    turn = trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0])
    tip = trimesh.creation.cylinder(0.0115, 0.06, sections=64).apply_transform(turn)
    meshes = {"tip.stl": tip.apply_translation([0, 0.0235, 0]).export(file_type="stl")}
    surface, session = SurfaceSpec("mesh", file="tip.stl"), make_session(2, frames_per_press=0)
    calibration = make_calibration(surface=surface, meshes=meshes)
    for low, fits in ((10.0, True), (30.0, False)):
        mount = replace(session.meta.mount, beta_deg=40.0, beta_range_deg=(low, 60.0))
        dataset = replace(session, meta=replace(session.meta, surface=surface, mount=mount), meshes=meshes)
        if fits:
            check_same_sensor(calibration, dataset)
            continue
        with pytest.raises(InputError, match="beta_range_deg: expected a range with the calibrated beta_deg"):
            check_same_sensor(calibration, dataset)
