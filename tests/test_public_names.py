"""Names that others rely on: these and no others, in this order, each with its documentation."""

from __future__ import annotations

from importlib import import_module

import pytest

NAMES = {
    "calibration": """
        EFFECT_NAMES FORMAT MARGIN_M SLACK_COLUMNS Calibration Columns Effect Finding FittedLaw
        Interval Loss ModelParameters Provenance check_same_sensor effect_from effects_of
        read_calibration sensor_differences skin_of stream_of write_calibration
    """,
    "effects": """
        COVARIATES EFFECTS Applied Contacted Effect EffectParameter EffectSkin HoldSession
        InputEffect LawEffect MemoryEffect Samples Setting SignalEffect SkinStream SpreadEffect
        Stage Steps Values effect hold_session hold_times met_before start
    """,
    "model": """
        ClosedForm ContactLaw Contacts Converter Cylinder FlatPunch Indenter MeshIndenter
        MeshSurface Patch Plane Pressures RayHits SensorPose Skin SkinParameters SkinResponse Sphere
        Status StressLaw Surface TaxelLayout contact_rotations patch_cells solve_penetration
    """,
    "ranges": """
        NAMES PRESETS JointDraws Name Narrowing Parameter Ranges from_calibration narrowing preset
        read_ranges write_ranges
    """,
    "robot": """
        DEFAULT_HAND FORMAT Chain FingerDescription HandDescription HandState ImpedanceGains
        JointContact JointLimits Kinematics TipFrames bundled_hand check_limits contact_from_joints
        hand_named joint_contact_force place_indenter read_hand urdf_with_sphere
    """,
    "sim": """
        JointTruth PositionError ReferenceSkin SimOptions SimulatedHand SkinMemory TrueContact Truth
        TruthOptions position_error
    """,
}


@pytest.mark.parametrize("package", NAMES)
def test_public_names_are_these_and_documented(package: str) -> None:
    module = import_module(f"skincal.{package}")
    assert module.__all__ == NAMES[package].split()
    assert all(getattr(module, name).__doc__ for name in module.__all__)
