"""The hand: its description, its kinematics, and the contact inferred from its joints."""

from skincal.robot.chain import Chain, TipFrames
from skincal.robot.description import (
    FingerDescription,
    HandDescription,
    HandState,
    ImpedanceGains,
    JointLimits,
    check_limits,
)
from skincal.robot.hand_file import DEFAULT_HAND, FORMAT, bundled_hand, hand_named, read_hand
from skincal.robot.kinematics import (
    JointContact,
    Kinematics,
    contact_from_joints,
    joint_contact_force,
    place_indenter,
)
from skincal.robot.urdf import urdf_with_sphere

__all__ = [
    "DEFAULT_HAND", "FORMAT", "Chain", "FingerDescription", "HandDescription", "HandState", "ImpedanceGains",
    "JointContact", "JointLimits", "Kinematics", "TipFrames", "bundled_hand", "check_limits",
    "contact_from_joints", "hand_named", "joint_contact_force", "place_indenter", "read_hand",
    "urdf_with_sphere",
]  # fmt: skip
