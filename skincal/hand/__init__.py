"""Hands: the driver interface, and the guard that stands between a hand and whoever moves it."""

from skincal.hand.driver import HandCommand, HandDriver, HandState
from skincal.hand.errors import HandError
from skincal.hand.guard import GuardedHand
from skincal.hand.options import GuardOptions

__all__ = ["GuardOptions", "GuardedHand", "HandCommand", "HandDriver", "HandError", "HandState"]
