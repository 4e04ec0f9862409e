"""The fingers of the simulated hand as rigid bodies; hands and processes share nothing."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from skincal.errors import WorkError, text_of
from skincal.model.arrays import FloatArray
from skincal.robot import HandDescription, urdf_with_sphere
from skincal.sim.physics_client import Client, Loaded
from skincal.sim.sim_options import SimOptions


class Fingers:
    """The fingers of a hand; only the tip with the skin and the indenter collide, softly."""

    def __init__(
        self, description: HandDescription, options: SimOptions, contact_stiffness_n_per_m: float
    ) -> None:
        self._client = Client()
        self._fingers = self._load(description)
        self._largest_force = options.largest_force_n
        links = self._fingers.links
        tips = links[description.skin_finger.tip_link], links[description.indenter_finger.tip_link]
        self._skin, self._indenter = tips
        self._set_up(options, contact_stiffness_n_per_m)
        self._client.reset_joints(self._fingers, description.home_rad.tolist())

    def _load(self, description: HandDescription) -> Loaded:
        client, link = self._client, description.indenter_finger.tip_link
        urdf = urdf_with_sphere(description.urdf, link, description.indenter_radius_m)
        try:
            with TemporaryDirectory(prefix="skincal-") as folder:
                file = Path(folder) / "hand.urdf"
                file.write_bytes(urdf)
                return client.load_fingers(file, description.joints)
        except client.error as error:
            self.close()
            text = f"{description.urdf}: expected a URDF that PyBullet can load; got: {text_of(error)}"
            raise WorkError(text) from error

    def _set_up(self, options: SimOptions, contact_stiffness_n_per_m: float) -> None:
        client, body = self._client, self._fingers.body
        step_s = 1.0 / options.physics_hz
        client.setPhysicsEngineParameter(fixedTimeStep=step_s, deterministicOverlappingPairs=1)
        for link in range(-1, client.getNumJoints(body)):
            client.setCollisionFilterGroupMask(body, link, 0, 0)
        for link in (self._skin, self._indenter):
            client.soften(
                body, link, lateral=math.sqrt(options.friction), stiffness_n_per_m=contact_stiffness_n_per_m,
                damping_ns_per_m=options.contact_damping_ns_per_m,
            )  # fmt: skip
        client.setCollisionFilterPair(body, body, self._skin, self._indenter, 1)

    def joints(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Return angles [rad] and velocities [rad/s] of the links (n,)."""
        rows = self._client.getJointStates(self._fingers.body, self._fingers.joints)
        q, dq, _forces, _torques = zip(*rows, strict=True)
        return q, dq

    def step(self, torque_nm: Sequence[float]) -> None:
        """Advance by one step under torques (n,) [N m]."""
        client, body, joints = self._client, self._fingers.body, self._fingers.joints
        client.setJointMotorControlArray(body, joints, client.TORQUE_CONTROL, forces=torque_nm)
        client.stepSimulation()

    def force(self) -> FloatArray:
        """Return the force of the indenter on the skin in the last step (3,), frame of the URDF's root [N]."""
        body = self._fingers.body
        return summed_force(self._client.getContactPoints(body, body) or (), self._skin, self._largest_force)

    def close(self) -> None:
        """Close the client; may be called twice."""
        self._client.close()


def summed_force(points: Sequence[Sequence[Any]], skin_link: int, largest_n: float) -> FloatArray:
    """Return the force on a link (3,) [N] as the sum over PyBullet's contact points.

    PyBullet sometimes gives a force or a normal that is NaN, infinite or absurd (bullet3 #4232): such a point is left
    out, as is one that pulls.
    """
    total = np.zeros(3)
    for row in points:
        normal_force = float(row[9])
        if not 0.0 < normal_force <= largest_n:
            continue
        force = normal_force * np.array(row[7])
        # A comparison with NaN is false.
        if not abs(np.linalg.norm(row[7]) - 1.0) <= 1e-3:
            continue
        for size, direction in ((row[10], row[11]), (row[12], row[13])):
            sideways = float(size) * np.array(direction)
            if np.isfinite(sideways).all() and abs(float(size)) <= largest_n:
                force = force + sideways
        # Normal and friction act on the first of the two links.
        total += force if row[3] == skin_link else -force
    return total
