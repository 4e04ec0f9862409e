from __future__ import annotations

import skincal.model

NAMES = """
ClosedForm ContactLaw Contacts Converter Cylinder FlatPunch Indenter MeshIndenter MeshSurface Patch Plane Pressures
RayHits SensorPose Skin SkinParameters SkinResponse Sphere Status StressLaw Surface TaxelLayout contact_rotations
patch_cells solve_penetration
"""


def test_public_names_are_these_and_documented():
    assert set(skincal.model.__all__) == set(NAMES.split())
    for name in NAMES.split():
        assert getattr(skincal.model, name).__doc__
