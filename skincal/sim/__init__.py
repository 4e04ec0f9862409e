"""The simulated hand in a PyBullet client: fingers, drives, contact, and a reference skin with a hidden truth."""

from skincal.sim.physics_client import SimOptions
from skincal.sim.position_error import PositionError, position_error
from skincal.sim.reference_skin import ReferenceSkin
from skincal.sim.simulated_hand import SimulatedHand
from skincal.sim.touch import SkinMemory, TrueContact
from skincal.sim.truth import JointTruth, Truth, TruthOptions

__all__ = [
    "JointTruth", "PositionError", "ReferenceSkin", "SimOptions", "SimulatedHand", "SkinMemory",
    "TrueContact", "Truth", "TruthOptions", "position_error",
]  # fmt: skip
