"""Force regulator: normal force to a reference, shear to zero."""

from __future__ import annotations

import numpy as np

from skincal.collect.senses import Sample
from skincal.model.arrays import FloatArray


class Regulator:
    """Proportional-integral controller of the force, for fingers with stick friction in their joints.

    The command is the force that the fingers would give by their stiffness alone. Stick friction takes some of it, more
    when the motion reverses, and lets shear grow; both show in the measured torques and are regulated to zero.

    Args:
        period_s: time between two steps [s].
        filter_s: time constant of the low-pass on the measured force [s].
        lag_s: lag of the force behind the command, before that low-pass [s].
        share: proportional gain.
        per_s: integral gain [1/s].
    """

    def __init__(self, period_s: float, filter_s: float, lag_s: float, share: float, per_s: float) -> None:
        self._smooth = period_s / (filter_s + period_s)
        self._follow = period_s / (filter_s + lag_s + period_s)
        self._share, self._gain = share, per_s * period_s
        self._sum: FloatArray = np.zeros(3)
        self._start: FloatArray = np.zeros(3)
        self._expected: FloatArray = np.zeros(3)
        self.measured_n: FloatArray = np.zeros(3)
        self.command_n: FloatArray = np.zeros(3)

    @property
    def normal_n(self) -> float:
        """The smoothed normal force [N]."""
        return float(self.measured_n[0])

    def see(self, sample: Sample) -> None:
        """Add a measurement."""
        force = (sample.force_n, sample.shear_u_n, sample.shear_v_n)
        self.measured_n = self.measured_n + self._smooth * (np.array(force) - self.measured_n)

    def begin(self) -> None:
        """Start at the present force, as that of the present command."""
        self._start = self.measured_n.copy()
        self._start[1:] = 0.0
        self._expected = self._start.copy()
        self._sum = np.zeros(3)

    def regulate(self, normal_n: float, bound_n: float) -> None:
        """Compute the next command.

        The measured force is compared with the force expected by now without friction. Otherwise a ramp would fill the
        integral, and the force would overshoot its target.

        Args:
            normal_n: reference of the normal force [N].
            bound_n: bound of each part of the command, of either sign [N].
        """
        reference = np.array([normal_n, 0.0, 0.0])
        self._expected = self._expected + self._follow * (reference - self._expected)
        error = self._expected - self.measured_n
        self._sum = np.clip(self._sum + self._gain * error, -bound_n, bound_n)
        command = reference - self._start + self._share * error + self._sum
        self.command_n = np.clip(command, -bound_n, bound_n)
