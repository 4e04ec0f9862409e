"""PyBullet: one client that shares nothing with others, the fingers of a hand in it, and options of the simulation."""

from __future__ import annotations

import ctypes
import importlib
import importlib.util
import math
import os
import sys
from collections.abc import Generator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from inspect import isbuiltin
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from skincal.errors import WorkError, check_options, input_error, text_of
from skincal.model.arrays import FloatArray
from skincal.robot import HandDescription, urdf_with_sphere


@dataclass(frozen=True)
class SimOptions:
    """Physics and sensors of the simulated hand; figures that are not measured are assumptions.

    Attributes:
        physics_hz: steps of physics and controller (paper: 1000) [Hz].
        taxel_hz: tactile images [Hz]; a whole number of physics steps apart.
        taxel_scan_s: time between the first and the last taxel of an image [s].
        link_damping_nms_per_rad: damping in the drives' elasticity [N m s/rad].
        contact_depth_force_n: the contact's spring constant is force over depth of the skin at this force [N].
        contact_damping_ns_per_m: damping of the contact [N s/m].
        friction: coefficient of friction between skin and indenter.
        largest_force_n: larger contact forces are solver errors, and rejected [N].
    """

    physics_hz: int = 1000
    taxel_hz: int = 25
    taxel_scan_s: float = 1.5e-3
    link_damping_nms_per_rad: float = 0.01
    contact_depth_force_n: float = 3.0
    contact_damping_ns_per_m: float = 10.0
    friction: float = 0.8
    largest_force_n: float = 1e3

    def __post_init__(self) -> None:
        check_options(self, "a number, 0 or more", lambda value: value >= 0)
        if self.taxel_hz < 1 or self.physics_hz % self.taxel_hz:
            expected = f"a divisor of physics_hz = {self.physics_hz}"
            raise input_error("SimOptions.taxel_hz", expected, self.taxel_hz)


@dataclass(frozen=True)
class Loaded:
    """Fingers in a client.

    Attributes:
        body: PyBullet's number of them.
        joints: PyBullet's numbers of the joints.
        links: PyBullet's numbers of all links, by name.
    """

    body: int
    joints: list[int]
    links: Mapping[str, int]


class Client:
    """PyBullet with one client's number filled in; a function is bound once, when it is first asked for.

    Attributes:
        module: PyBullet itself, for loops that cannot afford a bound function.
        number: the client's number; -1 once it is closed.
    """

    def __init__(self, *, window: bool = False) -> None:
        with quiet():
            check_engine()
            self.module: Any = importlib.import_module("pybullet")
            self.number: int = self.module.connect(self.module.GUI if window else self.module.DIRECT)
        if self.number < 0:
            fix = "Close simulated hands and environments no longer used."
            raise WorkError(f"physics: PyBullet gives no further client. {fix}")

    def __getattr__(self, name: str) -> Any:
        value = getattr(self.module, name)
        bound = partial(value, physicsClientId=self.number) if isbuiltin(value) else value
        setattr(self, name, bound)
        return bound

    def load_fingers(self, urdf: Path, joints: Sequence[str]) -> Loaded:
        """Load fingers that neither move nor are damped by themselves, in a world without gravity.

        A torque-controlled hand compensates gravity.
        """
        self.setGravity(0, 0, 0)
        flags = self.URDF_USE_INERTIA_FROM_FILE | self.URDF_USE_SELF_COLLISION
        with quiet():
            body: int = self.loadURDF(str(urdf), useFixedBase=True, flags=flags)
        count: int = self.getNumJoints(body)
        rows = [self.getJointInfo(body, i) for i in range(count)]
        numbers = {row[1].decode(): row[0] for row in rows}
        own = [numbers[name] for name in joints]
        # PyBullet's own motors would hold the joints.
        self.setJointMotorControlArray(body, own, self.VELOCITY_CONTROL, forces=[0.0] * len(own))
        for link in range(-1, count):
            self.changeDynamics(body, link, linearDamping=0, angularDamping=0, jointDamping=0)
        return Loaded(body, own, {row[12].decode(): row[0] for row in rows})

    def soften(
        self,
        body: int,
        link: int,
        *,
        lateral: float,
        spinning: float = 0.0,
        rolling: float = 0.0,
        stiffness_n_per_m: float,
        damping_ns_per_m: float,
    ) -> None:
        """Set friction and softness of a contact on a link, as one of two alike.

        PyBullet combines friction as the product of the two links', and stiffness and damping in series.
        """
        self.changeDynamics(
            body,
            link,
            lateralFriction=lateral,
            spinningFriction=spinning,
            rollingFriction=rolling,
            restitution=0,
            contactStiffness=2 * stiffness_n_per_m,
            contactDamping=damping_ns_per_m / 2,
        )

    def reset_joints(self, fingers: Loaded, q_rad: Sequence[float]) -> None:
        """Put the joints at angles (n,) [rad], at rest."""
        for joint, angle in zip(fingers.joints, q_rad, strict=True):
            self.resetJointState(fingers.body, joint, angle, 0.0)

    def close(self) -> None:
        """End the client; may be called twice."""
        number, self.number = self.number, -1
        if number >= 0 and self.module.isConnected(number):
            self.module.disconnect(number)


def check_engine() -> None:
    """Check that PyBullet is installed, without importing it.

    Raises:
        InputError: it is not; there are no wheels for Python 3.12 and later.
    """
    if importlib.util.find_spec("pybullet") is None:
        here = f"none for Python {sys.version_info.major}.{sys.version_info.minor}"
        fix = "Use Python 3.11, for which it is installed with skincal; or build it: pip install pybullet"
        raise input_error("physics", "the package pybullet", here, fix)


@contextmanager
def quiet() -> Generator[None]:
    """Keep off standard output and error what PyBullet's C code prints when it is loaded and reads a URDF."""
    try:
        library = ctypes.CDLL(None)
        streams = [stream.fileno() for stream in (sys.__stdout__, sys.__stderr__) if stream is not None]
    except (OSError, ValueError, TypeError):
        yield
        return
    library.fflush(None)
    kept = [(stream, os.dup(stream)) for stream in streams]
    nothing = os.open(os.devnull, os.O_WRONLY)
    try:
        for stream in streams:
            os.dup2(nothing, stream)
        yield
    finally:
        library.fflush(None)
        for stream, copy in kept:
            os.dup2(copy, stream)
            os.close(copy)
        os.close(nothing)


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
