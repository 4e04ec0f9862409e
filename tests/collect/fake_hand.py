"""A hand without physics: angles follow commands with a lag, and the contact is a spring. Fast, and easy to spoil."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from skincal.collect.posture import Fingers, Mount
from skincal.dataset.placement import patch_coordinates
from skincal.hand import HandCommand, HandDriver, HandState
from skincal.robot import HandDescription, Kinematics, bundled_hand, contact_from_joints

Floats = NDArray[np.float64]

SKIN_N_PER_M = 8000.0
LAG_S = 0.03


class FakeHand(HandDriver):
    """The bundled hand with a springy skin.

    Args:
        seed: of the noise.
        spoil: is told the number of each state and changes it, raises, or hangs.
        torque_offset_nm: what the torque sensors are off.
        start_s: the hand's clock at connecting.
    """

    name = "fake"
    real_time = False

    def __init__(
        self,
        seed: int = 0,
        spoil: Callable[[int, HandState], HandState] | None = None,
        torque_offset_nm: float = 0.0,
        start_s: float = 0.0,
        description: HandDescription | None = None,
    ) -> None:
        self._hand = description or bundled_hand()
        self._kinematics = Kinematics(self._hand)
        self._fingers = Fingers(self._kinematics, Mount.of(self._hand.meta))
        self._rng = np.random.default_rng(seed)
        self._spoil, self._offset = spoil, torque_offset_nm
        self._time_s, self._states = start_s, 0
        self._free = self._desired = self._hand.home_rad.copy()
        self.stopped, self.closed, self.connected = False, False, False
        self.forces: list[float] = []

    def take_place_of(self, other: FakeHand) -> None:
        """Stands where the other hand was left."""
        self._free = self._desired = other._free

    @property
    def description(self) -> HandDescription:
        return self._hand

    @property
    def period_s(self) -> float:
        return 0.02

    def connect(self) -> None:
        self.connected = True

    def act(self, command: HandCommand) -> None:
        self._desired = command.q_desired_rad

    def stop(self) -> None:
        self.stopped = True

    def close(self) -> None:
        self.closed = True

    def observe(self) -> HandState:
        self._time_s += self.period_s
        before = self._free
        self._free = before + (self.period_s / (LAG_S + self.period_s)) * (self._desired - before)
        links, tau = self._pressed()
        q = links + self._hand.compliance_rad_per_nm * tau
        state = HandState(
            self._time_s,
            q,
            (self._free - before) / self.period_s,
            tau + self._offset + 1e-3 * self._rng.standard_normal(len(q)),
            self._desired.copy(),
            self._image(links, self.forces[-1]),
            np.full(16, self._time_s - 0.001),
        )
        self._states += 1
        return state if self._spoil is None else self._spoil(self._states, state)

    def _pressed(self) -> tuple[Floats, Floats]:
        """Angles and torques at which the skin's spring and the joints' are in balance."""
        nothing = np.zeros_like(self._free)
        links, torque, force = self._free, nothing, 0.0
        soft = 1 / self._hand.gains.stiffness_nm_per_rad + self._hand.compliance_rad_per_nm
        for _ in range(4):
            found = contact_from_joints(self._kinematics, links, nothing)
            torque = self._fingers.unit_torques(links, found.points_m[0], found.normals[0])[:, 0]
            # Without the force the links would be at the free angles; the gap is linear in it.
            stiff = 1 / float(torque @ (torque * soft))
            gap = float(found.gap_m[0]) - force / stiff
            force = max(0.0, -gap / (1 / stiff + 1 / SKIN_N_PER_M))
            links = self._free - force * torque * soft
            if force == 0:
                break
        self.forces.append(force)
        return links, force * torque

    def _image(self, links: Floats, force: float) -> Floats:
        mount = self._fingers.mount
        point = contact_from_joints(self._kinematics, links, np.zeros_like(links)).points_m
        away = mount.layout.centres_m - patch_coordinates(mount.surface, mount.pose, point)
        image = 60 * force * np.exp(-(away**2).sum(axis=1) / 0.0025**2)
        return np.clip(np.rint(image + self._rng.standard_normal(16)), 0, 255)
