"""World of a task and of the reference hand: two fingers, the skin of one, an object between them; its true state."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from skincal.envs.bodies import Body
from skincal.envs.drawing import Drawer, Value, Values, array, number
from skincal.envs.grasp import Grasp, GraspOptions
from skincal.envs.pinch import Pinch
from skincal.envs.scene import Frame, Scene, Touching, sound
from skincal.envs.tactile import RESOLUTION_M, SkinContact, TactileSkin
from skincal.model import SensorPose
from skincal.model.arrays import FloatArray
from skincal.ranges import Ranges
from skincal.tasks import ObjectName


@dataclass(frozen=True)
class Sensor:
    """Pose of the sensor on a fingertip of a radius [m]."""

    radius_m: float
    pose: SensorPose

    @classmethod
    def of(cls, pinch: Pinch, values: Values) -> Sensor:
        """Return the sensor of an episode; offsets of the centre are those from where it would be."""
        radius = pinch.radius_m
        alpha_rad, beta_rad = (math.radians(number(values, f"skin.{name}_deg")) for name in ("alpha", "beta"))
        y_m = number(values, "skin.y_m") + number(values, "skin.y_offset_m")
        return cls(radius, SensorPose(y_m, alpha_rad, beta_rad + number(values, "skin.x_offset_m") / radius))

    def patch_m(self, point_m: FloatArray) -> FloatArray:
        """Return patch coordinates (2,) of the surface's point nearest to a point (3,) of the fingertip frame [m]."""
        turn = math.remainder(math.atan2(point_m[0], point_m[2]) - self.pose.beta_rad, 2 * math.pi)
        return self.turned(self.radius_m * turn, point_m[1] - self.pose.y_m)

    def direction(self, vector: FloatArray) -> FloatArray:
        """Return the part (2,) of a vector (3,) along the patch's axes, on the tangent plane at its centre."""
        across = vector[0] * math.cos(self.pose.beta_rad) - vector[2] * math.sin(self.pose.beta_rad)
        return self.turned(across, vector[1])

    def turned(self, across: float, along: float) -> FloatArray:
        """Return a way round and along the finger, along the patch's axes (2,)."""
        cos, sin = math.cos(self.pose.alpha_rad), math.sin(self.pose.alpha_rad)
        return np.array([across * cos + along * sin, along * cos - across * sin])


@dataclass(frozen=True, eq=False)
class View:
    """A moment of an episode.

    Attributes:
        q_rad: (n,) true angles of the links [rad].
        dq_rad_per_s: (n,) their velocities [rad/s].
        skin: what the finger with the skin feels; None: nothing.
        tip: frame of the fingertip.
        thumb_tip: frame of the thumb's tip.
        body: the object's frame.
        velocity_m_per_s: (3,) the object's, root frame [m/s].
        spin_rad_per_s: (3,) the object's, root frame [rad/s].
        position_m: (2,) the place on the sensor that is nearest to the object's centre, patch coordinates [m].
        held: whether it is still held in place.
        sound: whether all of this can be believed.
    """

    q_rad: FloatArray
    dq_rad_per_s: FloatArray
    skin: Touching | None
    thumb: Touching | None
    tip: Frame
    thumb_tip: Frame
    body: Frame
    velocity_m_per_s: FloatArray
    spin_rad_per_s: FloatArray
    position_m: FloatArray
    held: bool
    sound: bool

    @property
    def dropped(self) -> bool:
        """Return whether a finger has lost the object."""
        return not self.sound or (not self.held and (self.skin is None or self.thumb is None))

    def right_contact(self, pinch: Pinch) -> bool:
        """Return whether the tip of the thumb and the cylindrical part of the finger touch it."""
        if self.skin is None or self.thumb is None:
            return False
        low, high = pinch.cylinder_m
        y = float(self.tip.inside(np.array(self.skin.point_m))[1])
        return (
            low <= y <= high
            and float(self.thumb_tip.inside(np.array(self.thumb.point_m))[1]) >= pinch.thumb.tip_from_m
        )

    def skin_contact(self, body: Body) -> SkinContact | None:
        """Return the contact as the skin feels it."""
        if self.skin is None or not self.sound:
            return None
        tip = self.tip.rotation
        vectors = np.array([self.skin.normal, self.skin.friction_n]) @ tip
        places = np.array([self.skin.point_m, self.body.origin_m]) - self.tip.origin_m
        place, centre = places @ tip
        normal, friction = vectors
        contacts = body.contacts(place, normal, self.skin.force_n, centre, tip.T @ self.body.rotation)
        across = normal[2] * friction[0] - normal[0] * friction[2]
        return SkinContact(contacts, float(across), float(friction[1]))

    @classmethod
    def of(cls, scene: Scene, sensor: Sensor, which: int = 0) -> View:
        """Return the view of one object of a scene."""
        q, dq = scene.joints()
        skin, thumb = scene.touches(which)
        (tip, thumb_tip), body = scene.tips(), scene.object_frame(which)
        velocity, spin = scene.object_motion(which)
        believed = sound(q, dq, body.origin_m)
        return cls(
            q_rad=q,
            dq_rad_per_s=dq,
            skin=skin,
            thumb=thumb,
            tip=tip,
            thumb_tip=thumb_tip,
            body=body,
            velocity_m_per_s=velocity,
            spin_rad_per_s=spin,
            position_m=sensor.patch_m(tip.inside(body.origin_m)) if believed else np.zeros(2),
            held=scene.held,
            sound=believed,
        )


class World:
    """Two fingers with a skin and an object, and the values that an episode gives them.

    Args:
        pinch: the hand.
        kind: the object.
        ranges: that episodes are drawn from.
        grasp: options of the grasp.
        resolution_m: longest edge of a tactile point's cell [m].

    Attributes:
        scene: the physics; None: not begun, or closed.
        values: draws of the episode.
        noise: draws of the step.
        body: the object of the episode.
        sensor: the sensor of the episode.
        offset_rad: errors of the joint sensors in the episode (n,) [rad].
    """

    values: Values
    noise: Values
    body: Body
    sensor: Sensor
    offset_rad: FloatArray

    def __init__(
        self,
        pinch: Pinch,
        kind: ObjectName,
        ranges: Ranges,
        grasp: GraspOptions | None = None,
        resolution_m: float = RESOLUTION_M,
    ) -> None:
        self.pinch = pinch
        self.kind: ObjectName = kind
        self.skin = TactileSkin(pinch, resolution_m)
        self.drawer = Drawer(ranges, kind, pinch, self.skin.taxels)
        self.grasp = Grasp(pinch, self.drawer.nominal, grasp or GraspOptions())
        self.scene: Scene | None = None

    @property
    def running(self) -> Scene:
        """The scene, of which there must be one."""
        assert self.scene is not None
        return self.scene

    def begin(self, values: Values, body: Body) -> None:
        """Take the draws and the object of an episode."""
        self.values, self.body = values, body
        self.offset_rad = array(values, "finger.joint_offset_rad")
        self.sensor = Sensor.of(self.pinch, values)

    def begin_skin(self, age_s: float) -> None:
        """Begin an episode of the skin, in a session that has gone on for some time [s]."""
        self.skin.begin(self.values, self.sensor.pose, self.body, age_s)

    def drawn(self, path: str) -> Value:
        """Return a value that is drawn in each step, or else for the episode."""
        return self.noise.get(path, self.values[path])

    def command(self, q_rad: FloatArray) -> None:
        """Move towards joint angles (n,), which the controller sees with the sensors' offsets [rad]."""
        self.running.drives.target_rad = q_rad - self.offset_rad

    def push(self) -> None:
        """Let weight and the random force act on the object."""
        weight = self.body.mass_kg * self.pinch.gravity_m_per_s2
        self.running.force_n = (weight + self.drawn(f"object.{self.kind}.random_force_n")).tolist()

    def measured_rad(self) -> FloatArray:
        """Return the joint angles (n,) as the sensors measure them [rad]."""
        return self.running.drives.motor_rad + self.offset_rad + self.drawn("finger.joint_noise_rad")

    def look(self, which: int = 0) -> View:
        """Return a look at one of the objects."""
        return View.of(self.running, self.sensor, which)

    def image(self, contact: SkinContact | None, time_s: float) -> FloatArray:
        """Return the next tactile image (J,) [counts]."""
        return self.skin.image(contact, time_s, np.asarray(self.drawn("skin.taxel_noise_counts")))

    def close(self) -> None:
        """End the physics; may be called twice."""
        if self.scene is not None:
            self.scene.close()
            self.scene = None
