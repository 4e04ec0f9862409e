"""Interface of a physics engine to the tasks: two fingers and one object or several."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod

from skincal.envs.pinch import Pinch
from skincal.envs.scene_state import Frame, Grip, Touching
from skincal.errors import input_error
from skincal.model.arrays import FloatArray
from skincal.sim.drives import Drives
from skincal.tasks import Engine

PHYSICS_HZ = 1000
"""Steps of physics and controller (the paper's) [Hz]."""
LARGEST_FORCE_N = 200.0
"""Contact forces beyond this are artefacts of the solver and are ignored [N]; the drives can exert some 20 N."""
_LARGEST_ANGLE_RAD = 1e2
"""A norm of all joint angles beyond this is absurd [rad]."""
_FAR_M = 10.0
"""An object beyond this is absurdly far [m]."""


class Scene(ABC):
    """Two fingers and the objects they hold in one engine; nothing is shared between scenes or processes.

    Attributes:
        drives: of the joints; their targets are set from outside.
        force_n: acts on each object's centre all the time, frame of the URDF's root (3,) [N].
        held: whether the objects are still held in place.
    """

    drives: Drives
    force_n: list[float]
    held: bool = False

    @abstractmethod
    def begin(self, grip: Grip) -> None:
        """Build the world anew, so that nothing of an earlier episode is left; objects are held in place."""

    @abstractmethod
    def release(self) -> None:
        """Let go of all objects."""

    @abstractmethod
    def run(self, steps: int) -> None:
        """Move on by some physics steps."""

    @abstractmethod
    def touches(self, which: int | None = None) -> tuple[Touching | None, Touching | None]:
        """Return the contacts of the tip with the skin and of the thumb with one object; None: with all of them."""

    @abstractmethod
    def joints(self) -> tuple[FloatArray, FloatArray]:
        """Return angles [rad] and velocities [rad/s] of the links (n,)."""

    @abstractmethod
    def tips(self) -> tuple[Frame, Frame]:
        """Return the frames of the tip with the skin and of the thumb's."""

    @abstractmethod
    def object_frame(self, which: int = 0) -> Frame:
        """Return the frame of an object."""

    @abstractmethod
    def object_motion(self, which: int = 0) -> tuple[FloatArray, FloatArray]:
        """Return an object's velocity [m/s] and angular velocity [rad/s], each (3,)."""

    @abstractmethod
    def gap_m(self) -> float:
        """Return the smallest distance between a tip and an object [m], negative inside; at most 0.05 m."""

    @abstractmethod
    def close(self) -> None:
        """End it; may be called twice."""

    def _begin_drives(self, grip: Grip) -> None:
        self.drives = Drives(grip.drives, grip.angles_rad, 1.0 / PHYSICS_HZ)
        self.drives.target_rad = grip.angles_rad
        self.force_n = [0.0, 0.0, 0.0]


def make_scene(
    engine: str, pinch: Pinch, iterations: int, *, window: bool = False, visible: bool = False
) -> Scene:
    """Return a scene in an engine.

    Raises:
        InputError: the engine is not installed.
    """
    # Each engine is loaded where it is used.
    if engine == "mujoco":
        from skincal.envs.mujoco_scene import MujocoScene

        return MujocoScene(pinch)
    from skincal.envs.bullet_scene import BulletScene

    return BulletScene(pinch, iterations, window=window, visible=visible)


def check_engine(engine: str, place: str) -> None:
    """Check the name of an engine.

    Raises:
        InputError: there is no such engine.
    """
    if engine not in [*Engine]:
        raise input_error(place, " or ".join(Engine), repr(engine))


def sound(q_rad: FloatArray, dq_rad_per_s: FloatArray, place_m: FloatArray) -> bool:
    """Return whether angles and velocities of the joints and the object's place (3,) are finite and not absurd."""
    # A comparison with NaN is false.
    moves = float(dq_rad_per_s @ dq_rad_per_s) < math.inf
    there = float(place_m @ place_m) < _FAR_M**2
    return moves and there and float(q_rad @ q_rad) < _LARGEST_ANGLE_RAD**2
