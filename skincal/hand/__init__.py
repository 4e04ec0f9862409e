"""Hands: the driver interface, and the guard between a hand and the program that moves it."""

from skincal.hand.driver import HandCommand, HandDriver, HandState, StageDescription, StageDriver, StageState
from skincal.hand.errors import HandError
from skincal.hand.guard import GuardedHand
from skincal.hand.guard_options import GuardOptions
from skincal.hand.registry import create_driver, create_rig, driver_names
from skincal.hand.stage_guard import GuardedStage

__all__ = [
    "GuardOptions", "GuardedHand", "GuardedStage", "HandCommand", "HandDriver", "HandError", "HandState",
    "StageDescription", "StageDriver", "StageState", "create_driver", "create_rig", "driver_names",
]  # fmt: skip
