"""Two fingers and an object in MuJoCo: the same bodies, drives and contacts as in PyBullet.

A contact is a spring and a damper that act on the next step's state, in both engines. MuJoCo's soft constraint is
``f = (-k r - b v - a) / R`` with a regularization R. With the step h, stiffness K and damping D of the grip,

    f = -K (r + h v + h^2 a) - D (v + h a)   gives   1 / R = K h^2 + D h,   k = K R,   b = (K h + D) R,

and R is set by the impedance d: ``R = (1 - d) / d`` times the two bodies' inverse weights. Friction has no spring, and
stops slip within one step.
"""

from __future__ import annotations

import importlib
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from skincal.envs.bodies import Body, Part
from skincal.envs.grip import Frame, Grip
from skincal.envs.pinch import Pinch
from skincal.envs.pinch_urdf import pinch_urdf
from skincal.envs.scene import LARGEST_FORCE_N, PHYSICS_HZ, Scene
from skincal.envs.touching import Point, Touching, merged
from skincal.errors import InputError, Problem

FloatArray = NDArray[np.float64]

_STEP_S = 1.0 / PHYSICS_HZ
_BODY, _HOLD = "object", "hold"
_FRICTION_RATIO = 1e4
"""How much harder friction is than the normal contact: 1 N slides by some 0.1 mm/s."""
_LONG = 4.0
"""Cylinders longer than so many radii get round ends beyond them."""
_SMALLEST = 1e-9
"""MuJoCo divides by friction coefficients."""
_ALONG_X = (math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0)
"""From the axis of its cylinders, z, to x (w, x, y, z)."""


class MujocoScene(Scene):
    """See :class:`Scene`.

    Args:
        pinch: the fingers.

    Raises:
        InputError: MuJoCo is not installed.
    """

    def __init__(self, pinch: Pinch) -> None:
        self._mj = _mujoco()
        self._pinch = pinch
        self._urdf = pinch_urdf(pinch, visible=False)
        self._tip_links = (pinch.description.skin_finger.tip_link, pinch.thumb.tip_link)

    def begin(self, grip: Grip) -> None:
        """See :meth:`Scene.begin`."""
        mj, spec = self._mj, self._world(grip)
        self._model: Any = spec.compile()
        self._data: Any = mj.MjData(self._model)
        self._names(grip)
        self._soften(grip)
        self._data.qpos[self._columns] = grip.angles_rad
        mj.mj_forward(self._model, self._data)
        self._begin_drives(grip)
        self.held = True

    def _world(self, grip: Grip) -> Any:
        """The fingers with the object, which a weld holds where it is."""
        mj = self._mj
        spec = mj.MjSpec.from_string(self._urdf.replace("</robot>", f"{_COMPILER}</robot>"))
        option = spec.option
        option.timestep, option.gravity = _STEP_S, [0.0, 0.0, 0.0]
        option.cone, option.impratio = mj.mjtCone.mjCONE_ELLIPTIC, _FRICTION_RATIO
        option.solver, option.iterations, option.tolerance = mj.mjtSolver.mjSOL_NEWTON, 50, 1e-10
        # A world that has gone astray is seen as such, not begun anew.
        option.disableflags |= int(mj.mjtDisableBit.mjDSBL_AUTORESET)
        tips = [self._tip_geom(spec, link) for link in self._tip_links]
        parts = self._add_body(spec, grip)
        for first, second in [*((tip, part) for tip in tips for part in parts), (tips[0], tips[1])]:
            spec.add_pair(name=f"{first} {second}", geomname1=first, geomname2=second)
        hold = spec.add_equality(name=_HOLD, type=mj.mjtEq.mjEQ_WELD, objtype=mj.mjtObj.mjOBJ_BODY)
        hold.name1, hold.name2 = _BODY, "world"
        hold.solref, hold.solimp = [2 * _STEP_S, 1.0], [0.9999, 0.9999, 1e-3, 0.5, 2.0]
        return spec

    def _tip_geom(self, spec: Any, link: str) -> str:
        geoms = spec.body(link).geoms
        if len(geoms) != 1:
            raise InputError(
                [
                    Problem(
                        f'URDF, link "{link}"', "one collision shape, for the engine mujoco", str(len(geoms))
                    )
                ]
            )
        geoms[0].name, geoms[0].contype, geoms[0].conaffinity = link, 0, 0
        return link

    def _add_body(self, spec: Any, grip: Grip) -> list[str]:
        """Adds the object; returns the names of its parts."""
        body: Body = grip.body
        x, y, z, w = Rotation.from_matrix(grip.rotation).as_quat().tolist()
        added = spec.worldbody.add_body(name=_BODY, pos=grip.position_m, quat=[w, x, y, z])
        added.add_freejoint()
        added.mass, added.inertia, added.explicitinertial = body.mass_kg, body.inertia_kg_m2, True
        for number, part in enumerate(body.parts):
            added.add_geom(name=f"{_BODY}-{number}", contype=0, conaffinity=0, **self._geom(part))
        return [f"{_BODY}-{number}" for number in range(len(body.parts))]

    def _geom(self, part: Part) -> dict[str, Any]:
        kinds = self._mj.mjtGeom
        if part.length_m is None:
            return {"type": kinds.mjGEOM_SPHERE, "size": [part.radius_m, 0, 0], "pos": [part.at_m, 0, 0]}
        # MuJoCo's cylinders touch a finger along a line in one point only; its capsules in two.
        kind = kinds.mjGEOM_CAPSULE if part.length_m > _LONG * part.radius_m else kinds.mjGEOM_CYLINDER
        size = [part.radius_m, part.length_m / 2, 0]
        return {"type": kind, "size": size, "pos": [part.at_m, 0, 0], "quat": _ALONG_X}

    def _names(self, grip: Grip) -> None:
        """Where joints, bodies and geoms are in MuJoCo's arrays."""
        model = self._model
        joints = [model.joint(name) for name in self._pinch.description.joints]
        self._columns = np.array([int(joint.qposadr[0]) for joint in joints])
        self._speeds = np.array([int(joint.dofadr[0]) for joint in joints])
        self._tips = [int(model.body(link).id) for link in self._tip_links]
        self._tip_geoms = [int(model.geom(link).id) for link in self._tip_links]
        self._parts = [int(model.geom(f"{_BODY}-{n}").id) for n in range(len(grip.body.parts))]
        self._body = int(model.body(_BODY).id)
        self._motion = int(model.body_dofadr[self._body])

    def _soften(self, grip: Grip) -> None:
        """Friction of a pair is the product of the two, as in PyBullet; contacts are springs with dampers."""
        model, last = self._model, self._model.npair - 1
        heavy = grip.stiffness_n_per_m * _STEP_S**2 + grip.damping_ns_per_m * _STEP_S
        for pair in range(model.npair):
            bodies = model.geom_bodyid[[model.pair_geom1[pair], model.pair_geom2[pair]]]
            light = float(model.body_invweight0[bodies, 0].sum())
            impedance = heavy * light / (1.0 + heavy * light)
            spring, damper = (
                impedance * value / heavy
                for value in (
                    grip.stiffness_n_per_m,
                    grip.stiffness_n_per_m * _STEP_S + grip.damping_ns_per_m,
                )
            )
            model.pair_solimp[pair] = [impedance, impedance, 1e-3, 0.5, 2.0]
            model.pair_solref[pair] = [-spring, -damper]
            model.pair_solreffriction[pair] = [-_SMALLEST, -impedance / _STEP_S]
            own = (grip.finger_friction, 0.0, 0.0) if pair == last else (
                grip.lateral_friction, grip.spinning_friction, grip.rolling_friction
            )  # fmt: skip
            slide, spin, roll = (max(grip.finger_friction * value, _SMALLEST) for value in own)
            model.pair_friction[pair] = [slide, slide, spin, roll, roll]
            model.pair_dim[pair] = 6 if own[2] > 0 else 4 if own[1] > 0 else 3

    def release(self) -> None:
        """See :meth:`Scene.release`."""
        self._data.eq_active[:] = 0
        self.held = False

    def run(self, steps: int) -> None:
        """See :meth:`Scene.run`."""
        model, data, move = self._model, self._data, self._mj.mj_step
        columns, speeds, drive = self._columns, self._speeds, self.drives.step
        data.xfrc_applied[self._body, :3] = self.force_n
        for _ in range(steps):
            data.qfrc_applied[speeds] = drive(data.qpos[columns].tolist(), data.qvel[speeds].tolist())
            move(model, data)

    def touches(self) -> tuple[Touching | None, Touching | None]:
        """See :meth:`Scene.touches`."""
        found: tuple[list[Point], list[Point]] = ([], [])
        for index in range(self._data.ncon):
            contact = self._data.contact[index]
            first, second = contact.geom
            if first in self._tip_geoms and second in self._parts:
                found[self._tip_geoms.index(first)].append(self._point(index, contact, 1.0))
            elif second in self._tip_geoms and first in self._parts:
                found[self._tip_geoms.index(second)].append(self._point(index, contact, -1.0))
        return merged(found[0], LARGEST_FORCE_N), merged(found[1], LARGEST_FORCE_N)

    def _point(self, index: int, contact: Any, sign: float) -> Point:
        """A contact point; with a sign of 1 the tip is MuJoCo's first geom, from which its normal points."""
        wrench = np.zeros(6)
        self._mj.mj_contactForce(self._model, self._data, index, wrench)
        axes = contact.frame.reshape(3, 3)
        normal = sign * axes[0]
        # Its place is midway between the two surfaces; its force acts on the second geom.
        place = contact.pos - normal * contact.dist / 2
        friction = -sign * (wrench[1:3] @ axes[1:])
        return Point(_vector(place), _vector(normal), float(wrench[0]), _vector(friction))

    def joints(self) -> tuple[FloatArray, FloatArray]:
        """See :meth:`Scene.joints`."""
        return self._data.qpos[self._columns].copy(), self._data.qvel[self._speeds].copy()

    def tips(self) -> tuple[Frame, Frame]:
        """See :meth:`Scene.tips`."""
        self._place()
        return self._frame(self._tips[0]), self._frame(self._tips[1])

    def object_frame(self) -> Frame:
        """See :meth:`Scene.object_frame`."""
        self._place()
        return self._frame(self._body)

    def _place(self) -> None:
        # After a step, MuJoCo's frames still are those of the step before.
        self._mj.mj_kinematics(self._model, self._data)

    def _frame(self, body: int) -> Frame:
        return Frame(self._data.xpos[body].copy(), self._data.xmat[body].reshape(3, 3).copy())

    def object_motion(self) -> tuple[FloatArray, FloatArray]:
        """See :meth:`Scene.object_motion`."""
        speed = self._data.qvel[self._motion : self._motion + 6]
        return speed[:3].copy(), self.object_frame().rotation @ speed[3:]

    def gap_m(self) -> float:
        """See :meth:`Scene.gap_m`."""
        self._place()
        distance = self._mj.mj_geomDistance
        return min(
            distance(self._model, self._data, tip, part, 0.05, None)
            for tip in self._tip_geoms
            for part in self._parts
        )

    def close(self) -> None:
        """See :meth:`Scene.close`: its memory is freed with it."""


_COMPILER = '<mujoco><compiler fusestatic="false" discardvisual="true" balanceinertia="false"/></mujoco>'


def _vector(values: FloatArray) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return x, y, z


def _mujoco() -> Any:
    try:
        module = importlib.import_module("mujoco")
    except ImportError as error:
        fix = "pip install 'skincal[mujoco]'"
        raise InputError([Problem("engine mujoco", "MuJoCo to be installed", str(error), fix)]) from error
    # Its warnings would go to standard output and to a file in the user's folder; what matters is seen in the state.
    module.set_mju_user_warning(_unheard)
    return module


def _unheard(text: object) -> None:
    """Takes a warning of MuJoCo."""
