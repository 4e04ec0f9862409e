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
    "LoadDerivatives",
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
    "along_surface",
    "contact_rotations",
    "load_derivatives",
    "patch_cells",
    "solve_penetration",
    "with_pose",
}


def test_public_names_are_these_and_no_others():
    assert set(skincal.model.__all__) == NAMES


def test_every_public_name_is_there_and_documented():
    for name in NAMES:
        assert getattr(skincal.model, name).__doc__
