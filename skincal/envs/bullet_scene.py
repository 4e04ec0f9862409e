"""Two fingers and their objects in a PyBullet client."""

from __future__ import annotations

import math
import shutil
import tempfile
import weakref
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from skincal.envs.bodies import Body
from skincal.envs.pinch import Pinch, pinch_urdf
from skincal.envs.scene import (
    LARGEST_FORCE_N,
    PHYSICS_HZ,
    Frame,
    Grip,
    Placed,
    Point,
    Scene,
    Touching,
    merged,
)
from skincal.model.arrays import FloatArray
from skincal.sim.physics_client import Client


class BulletScene(Scene):
    """See :class:`Scene`."""

    def __init__(self, pinch: Pinch, iterations: int, *, window: bool = False, visible: bool = False) -> None:
        self.engine = Client(window=window)
        self._pinch, self._iterations = pinch, int(iterations)
        folder = tempfile.mkdtemp(prefix="skincal-")
        self._tidy = weakref.finalize(self, shutil.rmtree, folder, ignore_errors=True)
        self._urdf = Path(folder) / "fingers.urdf"
        self._urdf.write_text(pinch_urdf(pinch, visible=visible), encoding="utf-8")
        self._visible = visible
        self.window = window

    def begin(self, grip: Grip) -> None:
        engine = self.engine
        engine.resetSimulation()
        engine.setPhysicsEngineParameter(
            fixedTimeStep=1.0 / PHYSICS_HZ,
            numSolverIterations=self._iterations,
            deterministicOverlappingPairs=1,
        )
        self._load_fingers(grip)
        self.bodies = [self._load_body(placed, grip) for placed in grip.objects]
        self._begin_drives(grip)
        self._constraints = [self._hold(*pair) for pair in zip(self.bodies, grip.objects, strict=True)]
        self.held = True

    def _load_fingers(self, grip: Grip) -> None:
        engine, description = self.engine, self._pinch.description
        self._fingers = engine.load_fingers(self._urdf, description.joints)
        body, links = self._fingers.body, self._fingers.links
        self._tip_links = (links[description.skin_finger.tip_link], links[self._pinch.thumb.tip_link])
        engine.reset_joints(self._fingers, grip.angles_rad.tolist())
        for link in range(-1, engine.getNumJoints(body)):
            if not engine.getCollisionShapeData(body, link):
                # It has no collision shape, so that the engine can skip it.
                engine.setCollisionFilterGroupMask(body, link, 0, 0)
        for link in self._tip_links:
            self._soften(body, link, grip, grip.finger_friction)

    @property
    def body(self) -> int:
        """PyBullet's number of the first object."""
        return self.bodies[0]

    def _load_body(self, placed: Placed, grip: Grip) -> int:
        engine, body = self.engine, placed.body
        made: int = engine.createMultiBody(
            body.mass_kg, self._shape(body), body.look(engine) if self._visible else -1,
            placed.position_m.tolist(), quaternion(placed.rotation),
        )  # fmt: skip
        inertia = body.inertia_kg_m2
        engine.changeDynamics(made, -1, linearDamping=0, angularDamping=0, localInertiaDiagonal=inertia)
        self._soften(made, -1, grip, grip.lateral_friction, grip.spinning_friction, grip.rolling_friction)
        return made

    def _soften(
        self, body: int, link: int, grip: Grip, lateral: float, spinning: float = 0.0, rolling: float = 0.0
    ) -> None:
        self.engine.soften(
            body, link, lateral=lateral, spinning=spinning, rolling=rolling,
            stiffness_n_per_m=grip.stiffness_n_per_m, damping_ns_per_m=grip.damping_ns_per_m,
        )  # fmt: skip

    def _hold(self, body: int, placed: Placed) -> int:
        engine = self.engine
        return engine.createConstraint(
            body, -1, -1, -1, engine.JOINT_FIXED, [0, 0, 0], [0, 0, 0], placed.position_m.tolist(),
            [0, 0, 0, 1], quaternion(placed.rotation),
        )  # fmt: skip

    def _shape(self, body: Body) -> int:
        """Return a collision shape of round parts, each along +x of the body's frame."""
        engine, parts = self.engine, body.parts
        if len(parts) == 1 and parts[0].length_m is None:
            return engine.createCollisionShape(engine.GEOM_SPHERE, radius=parts[0].radius_m)
        turn = engine.getQuaternionFromEuler([0, math.pi / 2, 0])
        return engine.createCollisionShapeArray(
            shapeTypes=[engine.GEOM_CYLINDER] * len(parts),
            radii=[part.radius_m for part in parts],
            lengths=[part.length_m for part in parts],
            collisionFramePositions=[[part.at_m, 0, 0] for part in parts],
            collisionFrameOrientations=[turn] * len(parts),
        )

    def release(self) -> None:
        for constraint in self._constraints:
            self.engine.removeConstraint(constraint)
        self.held = False

    def run(self, steps: int) -> None:
        """See :meth:`Scene.run`. PyBullet reads arguments by position faster than by name."""
        engine, client, bodies = self.engine.module, self.engine.number, self.bodies
        fingers, joints = self._fingers.body, self._fingers.joints
        force, drive = self.force_n, self.drives.step
        states, torques = engine.getJointStates, engine.setJointMotorControlArray
        pose = engine.getBasePositionAndOrientation
        push = engine.applyExternalForce
        move = engine.stepSimulation
        torque_control, world_frame = engine.TORQUE_CONTROL, engine.WORLD_FRAME
        for _ in range(steps):
            q, dq, _forces, _torques = zip(*states(fingers, joints, client), strict=True)
            torques(fingers, joints, torque_control, forces=drive(q, dq), physicsClientId=client)
            for body in bodies:
                push(body, -1, force, pose(body, client)[0], world_frame, client)
            move(client)

    def touches(self, which: int | None = None) -> tuple[Touching | None, Touching | None]:
        rows = [
            row
            for body in (self.bodies if which is None else [self.bodies[which]])
            for row in self.engine.getContactPoints(self._fingers.body, body) or ()
        ]
        skin, thumb = ([_point(row) for row in rows if row[3] == link] for link in self._tip_links)
        return merged(skin, LARGEST_FORCE_N), merged(thumb, LARGEST_FORCE_N)

    def joints(self) -> tuple[FloatArray, FloatArray]:
        rows = self.engine.getJointStates(self._fingers.body, self._fingers.joints)
        q, dq, _forces, _torques = zip(*rows, strict=True)
        return np.array(q), np.array(dq)

    def tips(self) -> tuple[Frame, Frame]:
        body, links = self._fingers.body, self._tip_links
        skin, thumb = self.engine.getLinkStates(body, links, computeForwardKinematics=1)
        return self._frame(skin[4], skin[5]), self._frame(thumb[4], thumb[5])

    def object_frame(self, which: int = 0) -> Frame:
        return self._frame(*self.engine.getBasePositionAndOrientation(self.bodies[which]))

    def object_motion(self, which: int = 0) -> tuple[FloatArray, FloatArray]:
        linear, angular = self.engine.getBaseVelocity(self.bodies[which])
        return np.array(linear), np.array(angular)

    def gap_m(self) -> float:
        near = self.engine.getClosestPoints
        rows = [row for body in self.bodies for row in near(self._fingers.body, body, 0.05)]
        return min((row[8] for row in rows if row[3] in self._tip_links), default=0.05)

    def close(self) -> None:
        self.engine.close()
        self._tidy()

    def _frame(self, origin_m: Sequence[float], turn: Sequence[float]) -> Frame:
        rotation = np.array(self.engine.getMatrixFromQuaternion(turn)).reshape(3, 3)
        return Frame(np.array(origin_m), rotation)


def _point(row: Sequence[Any]) -> Point:
    """Return a row of ``getContactPoints``, the fingers being the first body; its normal points at them."""
    x, y, z = row[7]
    one, two, along, across = row[10], row[12], row[11], row[13]
    friction = (
        one * along[0] + two * across[0],
        one * along[1] + two * across[1],
        one * along[2] + two * across[2],
    )
    return Point(row[5], (-x, -y, -z), row[9], friction)


def quaternion(rotation: FloatArray) -> list[float]:
    """Return the quaternion (x, y, z, w) of a rotation matrix (3, 3)."""
    return Rotation.from_matrix(rotation).as_quat().tolist()
