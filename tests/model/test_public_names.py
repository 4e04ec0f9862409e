from __future__ import annotations

import skincal.model

NAMES = {
    "ClosedForm",
    "ContactLaw",
    "Contacts",
    "Converter",
    "Cylinder",
    "FlatPunch",
    "Indenter",
    "MeshIndenter",
    "MeshSurface",
    "Patch",
    "Plane",
    "Pressures",
    "RayHits",
    "SensorPose",
    "Skin",
    "SkinParameters",
    "SkinResponse",
    "Sphere",
    "Status",
    "StressLaw",
    "Surface",
    "TaxelLayout",
    "contact_rotations",
    "patch_cells",
    "solve_penetration",
}


def test_public_names_are_these_and_no_others():
    assert set(skincal.model.__all__) == NAMES


def test_every_public_name_is_there_and_documented():
    for name in NAMES:
        assert getattr(skincal.model, name).__doc__
