"""Hands: the driver interface, and the guard that stands between a hand and whoever moves it."""

from skincal.hand.driver import HandCommand, HandDriver, HandState
from skincal.hand.errors import HandError
from skincal.hand.guard import GuardedHand
from skincal.hand.options import GuardOptions
from skincal.hand.registry import create_driver, driver_names

__all__ = [
    "GuardOptions",
    "GuardedHand",
    "HandCommand",
    "HandDriver",
    "HandError",
    "HandState",
    "create_driver",
    "driver_names",
]
