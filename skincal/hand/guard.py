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


class GuardedHand(Guarded[HandDescription, HandState, HandCommand]):
    """A hand that is safe to move; arguments are those of :class:`~skincal.hand.guarded.Guarded`.

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

    def nearest(self, q_desired_rad: FloatArray) -> HandCommand:
        """Return the allowed command nearest to some angles (n,) [rad], within joint limits and speed."""
        self._ready("nearest")
        return HandCommand(self._check_command.nearest(q_desired_rad, self._clock()))

    def _check_limits(self) -> None:
        check_limits(self.description, beyond=self._options.beyond_limits)

    def _checks(self) -> tuple[StateCheck, CommandCheck]:
        return StateCheck(self._made, self._options, self._contact_force), CommandCheck(self._made)
