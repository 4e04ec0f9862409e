"""Two fingers and their objects in MuJoCo: the same bodies, drives and contacts as in PyBullet.

A contact is a spring and a damper that act on the next step's state, in both engines. MuJoCo's soft constraint is
``f = (-k r - b v - a) / R`` with a regularization R. With the step h, stiffness K and damping D of the grip,

    f = -K (r + h v + h^2 a) - D (v + h a)   gives   1 / R = K h^2 + D h,   k = K R,   b = (K h + D) R,

and R is set by the impedance d: ``R = (1 - d) / d`` times the two bodies' inverse weights. Friction has no spring, and
stops slip within one step.
"""

from __future__ import annotations

import importlib
import math
from itertools import combinations, product
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from skincal.envs.bodies import Part
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
from skincal.errors import input_error
from skincal.model.arrays import FloatArray

_STEP_S = 1.0 / PHYSICS_HZ
_BODY, _HOLD = "object", "hold"
_FRICTION_RATIO = 1e6
"""How much harder friction is than the normal contact. It creeps: at 1 N some 0.1 um/s, at 10 mN m 0.1 deg/min."""
_LONG = 4.0
"""Cylinders longer than so many radii get round ends beyond them, and rest on balls along a finger."""
_ALONG = math.cos(math.radians(30.0))
"""Cosine of the angle between a finger and a cylinder up to which the cylinder lies along it."""
_NEVER_M = -1.0
"""Margin of a pair that shall not touch [m]."""
_SMALLEST = 1e-9
"""MuJoCo divides by friction coefficients."""
_ALONG_X = (math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0)
"""From the axis of its cylinders, z, to x (w, x, y, z)."""


class MujocoScene(Scene):
    """See :class:`Scene`.

    Raises:
        InputError: MuJoCo is not installed.
    """

    def __init__(self, pinch: Pinch) -> None:
        self._mj = _mujoco()
        self._pinch = pinch
        self._urdf = pinch_urdf(pinch, visible=False)
        self._tip_links = (pinch.description.skin_finger.tip_link, pinch.thumb.tip_link)

    def begin(self, grip: Grip) -> None:
        mj, spec = self._mj, self._world(grip)
        self._model: Any = spec.compile()
        self._data: Any = mj.MjData(self._model)
        self._names()
        self._soften(grip)
        self._data.qpos[self._columns] = grip.angles_rad
        mj.mj_kinematics(self._model, self._data)
        self._rest()
        mj.mj_forward(self._model, self._data)
        self._begin_drives(grip)
        self.held = True

    def _world(self, grip: Grip) -> Any:
        """Return the fingers with the objects, which welds hold where they are."""
        mj = self._mj
        spec = mj.MjSpec.from_string(self._urdf.replace("</robot>", f"{_COMPILER}</robot>"))
        option = spec.option
        option.timestep, option.gravity = _STEP_S, [0.0, 0.0, 0.0]
        option.cone, option.impratio = mj.mjtCone.mjCONE_ELLIPTIC, _FRICTION_RATIO
        option.solver, option.iterations, option.tolerance = mj.mjtSolver.mjSOL_NEWTON, 50, 1e-10
        # A simulation that diverges is detected by its state; MuJoCo must not reset it.
        option.disableflags |= int(mj.mjtDisableBit.mjDSBL_AUTORESET)
        tips = [self._tip_geom(spec, link) for link in self._tip_links]
        self._ball_names: list[str] = []
        self._part_names = [self._add_body(spec, k, placed) for k, placed in enumerate(grip.objects)]
        groups = [[tips[0]], [tips[1]], *self._part_names]
        for one, other in combinations(groups, 2):
            for first, second in product(one, other):
                spec.add_pair(name=f"{first} {second}", geomname1=first, geomname2=second)
        for k in range(len(grip.objects)):
            hold = spec.add_equality(
                name=f"{_HOLD}{k}", type=mj.mjtEq.mjEQ_WELD, objtype=mj.mjtObj.mjOBJ_BODY
            )
            hold.name1, hold.name2 = f"{_BODY}{k}", "world"
            hold.solref, hold.solimp = [2 * _STEP_S, 1.0], [0.9999, 0.9999, 1e-3, 0.5, 2.0]
        return spec

    def _tip_geom(self, spec: Any, link: str) -> str:
        geoms = spec.body(link).geoms
        if len(geoms) != 1:
            expected = "one collision shape, for the engine mujoco"
            raise input_error(f'URDF, link "{link}"', expected, len(geoms))
        geoms[0].name, geoms[0].contype, geoms[0].conaffinity = link, 0, 0
        return link

    def _add_body(self, spec: Any, which: int, placed: Placed) -> list[str]:
        """Add an object; returns the names of its parts."""
        body, name = placed.body, f"{_BODY}{which}"
        x, y, z, w = Rotation.from_matrix(placed.rotation).as_quat().tolist()
        added = spec.worldbody.add_body(name=name, pos=placed.position_m, quat=[w, x, y, z])
        added.add_freejoint()
        added.mass, added.inertia, added.explicitinertial = body.mass_kg, body.inertia_kg_m2, True
        # Left out, MuJoCo takes the body's own place in the world for that of its centre of mass in the body.
        added.ipos, added.iquat = [0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]
        shapes = [self._geom(part) for part in body.parts]
        balls = [ball for part in body.parts for ball in _balls(part)]
        names = [f"{name}-{number}" for number in range(len(shapes) + len(balls))]
        for part, shape in zip(names, [*shapes, *map(self._geom, balls)], strict=True):
            added.add_geom(name=part, contype=0, conaffinity=0, **shape)
        self._ball_names += names[len(shapes) :]
        return names

    def _geom(self, part: Part) -> dict[str, Any]:
        kinds = self._mj.mjtGeom
        if part.length_m is None:
            return {"type": kinds.mjGEOM_SPHERE, "size": [part.radius_m, 0, 0], "pos": [part.at_m, 0, 0]}
        kind = kinds.mjGEOM_CAPSULE if part.length_m > _LONG * part.radius_m else kinds.mjGEOM_CYLINDER
        size = [part.radius_m, part.length_m / 2, 0]
        return {"type": kind, "size": size, "pos": [part.at_m, 0, 0], "quat": _ALONG_X}

    def _rest(self) -> None:
        """Let a cylinder rest on its balls on those fingers that it lies along.

        MuJoCo gives a cylinder or capsule along a finger one point, which jumps from end to end: it would rock on it.
        """
        model, data = self._model, self._data
        for pair in range(model.npair):
            geoms = {int(model.pair_geom1[pair]), int(model.pair_geom2[pair])}
            tips, balls = geoms.intersection(self._tip_geoms), geoms.intersection(self._balls)
            if balls and tips:
                along = data.xmat[model.geom_bodyid[balls.pop()]].reshape(3, 3)[:, 0]
                axis = data.geom_xmat[tips.pop()].reshape(3, 3)[:, 2]
                model.pair_margin[pair] = 0.0 if abs(float(axis @ along)) > _ALONG else _NEVER_M

    def _names(self) -> None:
        """Look up the indices of joints, bodies and geoms in MuJoCo's arrays."""
        model = self._model
        joints = [model.joint(name) for name in self._pinch.description.joints]
        self._columns = np.array([int(joint.qposadr[0]) for joint in joints])
        self._speeds = np.array([int(joint.dofadr[0]) for joint in joints])
        self._tips = [int(model.body(link).id) for link in self._tip_links]
        self._tip_geoms = [int(model.geom(link).id) for link in self._tip_links]
        self._parts = [[int(model.geom(name).id) for name in names] for names in self._part_names]
        self._all_parts = [part for parts in self._parts for part in parts]
        self._balls = {int(model.geom(name).id) for name in self._ball_names}
        self._bodies = [int(model.body(f"{_BODY}{k}").id) for k in range(len(self._parts))]
        self._motions = [int(model.body_dofadr[body]) for body in self._bodies]

    def _soften(self, grip: Grip) -> None:
        """Friction of a pair is the product of the two, as in PyBullet; contacts are springs with dampers."""
        model = self._model
        stiffness, damping = grip.stiffness_n_per_m, grip.damping_ns_per_m
        heavy = stiffness * _STEP_S**2 + damping * _STEP_S
        for pair in range(model.npair):
            geoms = [int(model.pair_geom1[pair]), int(model.pair_geom2[pair])]
            bodies = model.geom_bodyid[geoms]
            light = float(model.body_invweight0[bodies, 0].sum())
            impedance = heavy * light / (1.0 + heavy * light)
            spring = impedance * stiffness / heavy
            damper = impedance * (stiffness * _STEP_S + damping) / heavy
            model.pair_solimp[pair] = [impedance, impedance, 1e-3, 0.5, 2.0]
            model.pair_solref[pair] = [-spring, -damper]
            model.pair_solreffriction[pair] = [-_SMALLEST, -impedance / _STEP_S]
            own = (grip.lateral_friction, grip.spinning_friction, grip.rolling_friction)
            # MuJoCo sorts its pairs.
            tips = len(set(self._tip_geoms).intersection(geoms))
            if tips == 2:
                own = (grip.finger_friction, 0.0, 0.0)
            elif tips == 0:
                own = (grip.lateral_friction, 0.0, 0.0)
            other = grip.finger_friction if tips else grip.lateral_friction
            slide, spin, roll = (max(other * value, _SMALLEST) for value in own)
            model.pair_friction[pair] = [slide, slide, spin, roll, roll]
            model.pair_dim[pair] = 6 if own[2] > 0 else 4 if own[1] > 0 else 3

    def release(self) -> None:
        self._data.eq_active[:] = 0
        self.held = False

    def run(self, steps: int) -> None:
        model, data, move = self._model, self._data, self._mj.mj_step
        columns, speeds, drive = self._columns, self._speeds, self.drives.step
        data.xfrc_applied[self._bodies, :3] = self.force_n
        for _ in range(steps):
            data.qfrc_applied[speeds] = drive(data.qpos[columns].tolist(), data.qvel[speeds].tolist())
            move(model, data)

    def touches(self, which: int | None = None) -> tuple[Touching | None, Touching | None]:
        parts = self._all_parts if which is None else self._parts[which]
        found: tuple[list[Point], list[Point]] = ([], [])
        for index in range(self._data.ncon):
            contact = self._data.contact[index]
            first, second = contact.geom
            if first in self._tip_geoms and second in parts:
                found[self._tip_geoms.index(first)].append(self._point(index, contact, 1.0))
            elif second in self._tip_geoms and first in parts:
                found[self._tip_geoms.index(second)].append(self._point(index, contact, -1.0))
        return merged(found[0], LARGEST_FORCE_N), merged(found[1], LARGEST_FORCE_N)

    def _point(self, index: int, contact: Any, sign: float) -> Point:
        """Return a contact point; with a sign of 1 the tip is MuJoCo's first geom, from which its normal points."""
        wrench = np.zeros(6)
        self._mj.mj_contactForce(self._model, self._data, index, wrench)
        axes = contact.frame.reshape(3, 3)
        normal = sign * axes[0]
        # Its place is midway between the two surfaces; its force acts on the second geom.
        place = contact.pos - normal * contact.dist / 2
        friction = -sign * (wrench[1:3] @ axes[1:])
        return Point(_vector(place), _vector(normal), float(wrench[0]), _vector(friction))

    def joints(self) -> tuple[FloatArray, FloatArray]:
        return self._data.qpos[self._columns].copy(), self._data.qvel[self._speeds].copy()

    def tips(self) -> tuple[Frame, Frame]:
        self._place()
        return self._frame(self._tips[0]), self._frame(self._tips[1])

    def object_frame(self, which: int = 0) -> Frame:
        self._place()
        return self._frame(self._bodies[which])

    def _place(self) -> None:
        # After a step, MuJoCo's frames still are those of the step before.
        self._mj.mj_kinematics(self._model, self._data)

    def _frame(self, body: int) -> Frame:
        return Frame(self._data.xpos[body].copy(), self._data.xmat[body].reshape(3, 3).copy())

    def object_motion(self, which: int = 0) -> tuple[FloatArray, FloatArray]:
        first = self._motions[which]
        speed = self._data.qvel[first : first + 6]
        return speed[:3].copy(), self.object_frame(which).rotation @ speed[3:]

    def gap_m(self) -> float:
        self._place()
        distance = self._mj.mj_geomDistance
        return min(
            distance(self._model, self._data, tip, part, 0.05, None)
            for tip in self._tip_geoms
            for part in self._all_parts
        )

    def close(self) -> None:
        """See :meth:`Scene.close`: its memory is freed with it."""


def _balls(part: Part) -> list[Part]:
    """Balls in a row inside a long cylinder, side by side."""
    if part.length_m is None or part.length_m <= _LONG * part.radius_m:
        return []
    half = int((part.length_m / 2 - part.radius_m) / (2 * part.radius_m))
    return [Part(part.radius_m, None, part.at_m + 2 * part.radius_m * n) for n in range(-half, half + 1)]


_COMPILER = '<mujoco><compiler fusestatic="false" discardvisual="true" balanceinertia="false"/></mujoco>'


def _vector(values: FloatArray) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return x, y, z


def _mujoco() -> Any:
    try:
        module = importlib.import_module("mujoco")
    except ImportError as error:
        fix = "pip install 'skincal[mujoco]'"
        raise input_error("engine mujoco", "MuJoCo to be installed", error, fix) from error
    # Its warnings would go to standard output and to a file in the user's folder; what matters is seen in the state.
    module.set_mju_user_warning(_drop)
    return module


def _drop(_: object) -> None: ...
