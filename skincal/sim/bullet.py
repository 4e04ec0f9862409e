"""A PyBullet client with one hand in it; objects and processes share nothing."""

from __future__ import annotations

import ctypes
import importlib
import importlib.util
import math
import os
import sys
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from skincal.errors import WorkError, input_error, text_of
from skincal.model.arrays import FloatArray
from skincal.robot import HandDescription, urdf_with_sphere
from skincal.sim.sim_options import SimOptions


class Fingers:
    """The fingers as rigid bodies, without gravity (a torque-controlled hand compensates it).

    Only the tip with the skin and the indenter collide, softly.
    """

    def __init__(
        self, description: HandDescription, options: SimOptions, contact_stiffness_n_per_m: float
    ) -> None:
        with quiet():
            self._engine: Any = load_engine()
            self._client: int = self._engine.connect(self._engine.DIRECT)
            if self._client < 0:
                raise WorkError(
                    "simulated hand: PyBullet gives no further client. Close hands no longer used."
                )
            self._body = self._load(description)
        self._largest_force = options.largest_force_n
        self._joints, self._skin, self._indenter = self._named(description)
        self._set_up(options, contact_stiffness_n_per_m)
        self.reset(description.home_rad.tolist())

    def _load(self, description: HandDescription) -> int:
        engine, client = self._engine, self._client
        flags = engine.URDF_USE_INERTIA_FROM_FILE | engine.URDF_USE_SELF_COLLISION
        radius_m = description.meta.indenter.radius_m
        assert radius_m is not None
        try:
            with TemporaryDirectory(prefix="skincal-") as folder:
                file = Path(folder) / "hand.urdf"
                file.write_bytes(
                    urdf_with_sphere(description.urdf, description.indenter_finger.tip_link, radius_m)
                )
                return engine.loadURDF(str(file), useFixedBase=True, flags=flags, physicsClientId=client)
        except engine.error as error:
            self.close()
            raise WorkError(
                f"{description.urdf}: expected a URDF that PyBullet can load; got: {text_of(error)}"
            ) from error

    def _named(self, description: HandDescription) -> tuple[list[int], int, int]:
        """Return PyBullet's indices of the joints, the skin's tip and the indenter."""
        engine, client = self._engine, self._client
        count: int = engine.getNumJoints(self._body, physicsClientId=client)
        rows = [engine.getJointInfo(self._body, i, physicsClientId=client) for i in range(count)]
        joints = {row[1].decode(): row[0] for row in rows}
        links = {row[12].decode(): row[0] for row in rows}
        tips = (description.skin_finger.tip_link, description.indenter_finger.tip_link)
        return [joints[name] for name in description.joints], links[tips[0]], links[tips[1]]

    def _set_up(self, options: SimOptions, contact_stiffness_n_per_m: float) -> None:
        engine, client, body = self._engine, self._client, self._body
        engine.setGravity(0, 0, 0, physicsClientId=client)
        engine.setPhysicsEngineParameter(
            fixedTimeStep=1.0 / options.physics_hz, deterministicOverlappingPairs=1, physicsClientId=client
        )
        # PyBullet's own motors would hold the joints.
        engine.setJointMotorControlArray(
            body,
            self._joints,
            engine.VELOCITY_CONTROL,
            forces=[0.0] * len(self._joints),
            physicsClientId=client,
        )
        for link in range(-1, engine.getNumJoints(body, physicsClientId=client)):
            engine.changeDynamics(
                body, link, linearDamping=0, angularDamping=0, jointDamping=0, physicsClientId=client
            )
            engine.setCollisionFilterGroupMask(body, link, 0, 0, physicsClientId=client)
        # PyBullet combines friction as the product of the two links', and stiffness in series.
        for link in (self._skin, self._indenter):
            engine.changeDynamics(
                body,
                link,
                lateralFriction=math.sqrt(options.friction),
                spinningFriction=0,
                rollingFriction=0,
                restitution=0,
                contactStiffness=2 * contact_stiffness_n_per_m,
                contactDamping=options.contact_damping_ns_per_m / 2,
                physicsClientId=client,
            )
        engine.setCollisionFilterPair(body, body, self._skin, self._indenter, 1, physicsClientId=client)

    def reset(self, q_rad: Sequence[float]) -> None:
        """Put the links at angles (n,) [rad], at rest."""
        for joint, angle in zip(self._joints, q_rad, strict=True):
            self._engine.resetJointState(self._body, joint, angle, 0.0, physicsClientId=self._client)

    def joints(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Return angles [rad] and velocities [rad/s] of the links (n,)."""
        rows = self._engine.getJointStates(self._body, self._joints, self._client)
        q, dq, _forces, _torques = zip(*rows, strict=True)
        return q, dq

    def step(self, torque_nm: Sequence[float]) -> None:
        """Advance by one step under torques (n,) [N m]."""
        engine, client = self._engine, self._client
        engine.setJointMotorControlArray(
            self._body, self._joints, engine.TORQUE_CONTROL, forces=torque_nm, physicsClientId=client
        )
        engine.stepSimulation(client)

    def force(self) -> FloatArray:
        """Return the force of the indenter on the skin in the last step (3,), frame of the URDF's root [N]."""
        points = self._engine.getContactPoints(self._body, self._body, physicsClientId=self._client)
        return summed_force(points or (), self._skin, self._largest_force)

    def close(self) -> None:
        """Close the client; may be called twice."""
        client, self._client = self._client, -1
        if client >= 0 and self._engine.isConnected(client):
            self._engine.disconnect(client)


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


def check_engine() -> None:
    """Check that PyBullet is installed, without importing it.

    Raises:
        InputError: it is not; there are no wheels for Python 3.12 and later.
    """
    if importlib.util.find_spec("pybullet") is None:
        here = f"none for Python {sys.version_info.major}.{sys.version_info.minor}"
        fix = "Use Python 3.11, for which it is installed with skincal; or build it: pip install pybullet"
        raise input_error("physics", "the package pybullet", here, fix)


def load_engine() -> Any:
    """Return the module ``pybullet``; raise as :func:`check_engine` does."""
    check_engine()
    return importlib.import_module("pybullet")


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
