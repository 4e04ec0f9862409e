"""PyBullet: one client that shares nothing with others, and the fingers of a hand in it."""

from __future__ import annotations

import ctypes
import importlib
import importlib.util
import os
import sys
from collections.abc import Generator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from inspect import isbuiltin
from pathlib import Path
from typing import Any

from skincal.errors import WorkError, input_error


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
