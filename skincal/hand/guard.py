"""The guard of a hand: what stands between a hand and whoever moves it (:mod:`skincal.hand.guarded`)."""

from __future__ import annotations

import time
from collections.abc import Callable

from skincal.hand.checks import ContactForce, StateCheck
from skincal.hand.commands import CommandCheck
from skincal.hand.driver import HandCommand, HandDriver, HandState
from skincal.hand.guard_options import GuardOptions
from skincal.hand.guarded import Guarded
from skincal.model.arrays import FloatArray
from skincal.robot import HandDescription, check_limits


class GuardedHand(Guarded[HandState, HandCommand]):
    """A hand that is safe to move: used as a driver is, within a ``with`` block, for one connection.

    Args:
        driver: the hand.
        options: limits and times.
        contact_force: the contact force of a state [N], from its joint angles and torques; None: not checked.
        clock: our clock [s].
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
        self._driver, self._contact_force = driver, contact_force

    @property
    def description(self) -> HandDescription:
        """The hand."""
        return self._driver.description

    def nearest(self, q_desired_rad: FloatArray) -> HandCommand:
        """Return the allowed command nearest to some angles (n,) [rad], within joint limits and speed."""
        self._ready("nearest")
        return HandCommand(self._commands.nearest(q_desired_rad, self._clock()))

    def _check_limits(self) -> None:
        check_limits(self.description, beyond=self._options.beyond_limits)

    def _checks(self) -> tuple[StateCheck, CommandCheck]:
        self._commands = CommandCheck(self._driver)
        return StateCheck(self._driver, self._options, self._contact_force), self._commands
