"""World of a task and of the reference hand: two fingers, the skin of one, and an object between them."""

from __future__ import annotations

import numpy as np

from skincal.envs.bodies import Body
from skincal.envs.drawing import Drawer, Value, Values, array
from skincal.envs.grasp import Grasp, GraspOptions
from skincal.envs.pinch import Pinch
from skincal.envs.scene import Scene
from skincal.envs.sensing import Sensor, View
from skincal.envs.tactile import RESOLUTION_M, SkinContact, TactileSkin
from skincal.model.arrays import FloatArray
from skincal.ranges import Ranges
from skincal.tasks import ObjectName


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
