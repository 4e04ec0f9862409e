"""The guard of a hand: what stands between a hand and whoever moves it (:mod:`skincal.hand.guard_calls`)."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from skincal.errors import shown
from skincal.hand.command_checks import CommandCheck
from skincal.hand.driver import HandCommand, HandDriver, HandState
from skincal.hand.errors import HandError
from skincal.hand.guard_calls import Guarded
from skincal.hand.guard_options import GuardOptions
from skincal.hand.state_checks import ContactForce, StateCheck
from skincal.model.arrays import FloatArray
from skincal.robot import HandDescription, check_limits


class GuardedHand(Guarded[HandDescription, HandState, HandCommand]):
    """A hand that is safe to move; arguments are those of :class:`~skincal.hand.guard_calls.Guarded`.

    Args:
        contact_force: the contact force of a state [N], from its joint angles and torques; None: not checked.
    """

    rig = "hand"

    def __init__(
        self,
        driver: HandDriver,
        options: GuardOptions | None = None,
        contact_force: ContactForce | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__(driver, options, clock)
        self._contact_force = contact_force

    def object_position_m(self) -> FloatArray:
        """Return where the hand sees the object (2,) [m]; NaN: it does not.

        Raises:
            HandError: the driver gave something else, failed or did not return; the hand has been stopped.
        """
        what = "object_position_m"
        place = self._call(what, self._made.object_position_m, timeout_s=self._options.timeout_s)
        if place is None:
            return np.full(2, np.nan)
        numbers = type(place) is np.ndarray and place.shape == (2,) and place.dtype == np.float64
        if not numbers or np.isinf(place).any():
            expected = "None, or an array of float64 of shape (2,), finite or NaN"
            self._fail(HandError(f"{what}: expected {expected}; got {shown(place)}", "state"))
        return place.copy()

    def _check_limits(self) -> None:
        check_limits(self.description, beyond=self._options.beyond_limits)

    def _checks(self) -> tuple[StateCheck, CommandCheck]:
        return StateCheck(self._made, self._options, self._contact_force), CommandCheck(self._made)
