"""True state of an episode, in the frames of the tasks."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from skincal.envs.bodies import Body
from skincal.envs.drawing import Values, number
from skincal.envs.pinch import Pinch
from skincal.envs.scene import Scene, sound
from skincal.envs.scene_state import Frame, Touching
from skincal.envs.tactile import SkinContact
from skincal.model import SensorPose
from skincal.model.arrays import FloatArray


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
