"""Names of the robot and sim rooms that others rely on."""

from __future__ import annotations

import skincal.robot
import skincal.sim

ROBOT = """
DEFAULT_HAND FORMAT Chain FingerDescription HandDescription HandState ImpedanceGains JointContact
JointLimits Kinematics TipFrames bundled_hand check_limits contact_from_joints place_indenter
read_hand hand_named joint_contact_force urdf_with_sphere
"""
SIM = """
JointTruth PositionError ReferenceSkin SimOptions SimulatedHand SkinMemory TrueContact Truth
TruthOptions position_error
"""


def test_public_names() -> None:
    for module, names in ((skincal.robot, ROBOT), (skincal.sim, SIM)):
        assert set(module.__all__) == set(names.split())
        assert all(getattr(module, name) is not None for name in names.split())
