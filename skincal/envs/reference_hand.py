"""A simulated hand with an object between its fingers and a hidden truth, as a driver: a policy's dress rehearsal.

What the policy's simulation randomizes is drawn here once and kept hidden: pose, elasticity, scale, gains, friction,
joint offsets; and the skin may have effects that no calibration has been told of. A person who holds the object until
both fingers have it is part of the simulation.
"""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from skincal.effects import EFFECTS
from skincal.envs.bodies import BODIES, body_of, turn_of
from skincal.envs.drawing import RIG_EFFECTS, Drawer, Values, array, number
from skincal.envs.grasp import Grasp, GraspOptions
from skincal.envs.needed import ObjectName, ranges_for
from skincal.envs.pinch import read_pinch
from skincal.envs.scene import PHYSICS_HZ, Scene, check_engine, make_scene
from skincal.envs.sensing import Sensor, View, view
from skincal.envs.tactile import TactileSkin, drawn_age_s
from skincal.errors import input_error
from skincal.files import whole_file
from skincal.hand.driver import HandCommand, HandDriver, HandState
from skincal.hand.errors import HandError
from skincal.model.arrays import FloatArray
from skincal.ranges import Ranges
from skincal.robot import HandDescription

TRUTH_FORMAT = "skincal-reference-truth/1"
_RELEASE_S = 0.25
"""The person lets go when both fingers have touched the object for so long [s]."""
_SOLVER_ITERATIONS = 50


class ReferenceHand(HandDriver):
    """A hand that holds a marble or a bolt; its clock runs as fast as the computer allows.

    The same seed, effects and commands give the same states.

    Args:
        task: what lies between the fingers: ``marble`` or ``bolt``.
        seed: draws the truth and all noise.
        effects: strength of each effect that the skin has, by name; 1 is a typical case.
        ranges: that the truth is drawn from: a file of them, the name of a preset, or ranges.
        hand: folder with ``hand.toml`` and ``pinch.toml``; None: the bundled hand.
        orientation_deg: how the bolt lies [°].
        truth_path: file for the truth (JSON), written when the hand is connected.
        rate_hz: states and commands [Hz].
        engine: the physics: ``pybullet`` or ``mujoco``.
        real_time: whether its clock keeps pace with ours, as that of a real hand does; else it goes on by one period
            whenever a state is asked for.

    Attributes:
        clock: that it keeps pace with, by ``monotonic`` and ``sleep``; None: none.

    Raises:
        InputError: a task, an effect, ranges or a rate that do not exist or do not fit.
    """

    name = "reference"

    def __init__(
        self,
        *,
        task: Annotated[str, "what lies between the fingers: marble or bolt"] = "marble",
        seed: Annotated[int, "draws the hidden truth and all noise"] = 0,
        effects: Annotated[Mapping[str, float] | None, "strengths of effects, 1 is a typical case"] = None,
        ranges: Annotated[Ranges | str, "ranges that the truth is drawn from: a file or a preset"] = "iros24",
        hand: Annotated[Path | None, "folder with hand.toml and pinch.toml"] = None,
        orientation_deg: Annotated[float, "how the bolt lies [deg]"] = 0.0,
        truth_path: Annotated[Path | None, "file for the truth (JSON)"] = None,
        rate_hz: Annotated[int, "states and commands per second"] = 100,
        engine: Annotated[str, "physics engine: pybullet or mujoco"] = "pybullet",
        real_time: Annotated[bool, "whether its clock keeps pace with ours, as a real hand's does"] = False,
    ) -> None:
        if task not in BODIES:
            raise input_error('driver "reference", option task', " or ".join(BODIES), repr(task))
        if not 0 < rate_hz <= PHYSICS_HZ or PHYSICS_HZ % rate_hz:
            expected = f"a divisor of the physics' {PHYSICS_HZ} Hz"
            raise input_error('driver "reference", option rate_hz', expected, rate_hz)
        check_engine(engine, 'driver "reference", option engine')
        self._engine, self.real_time = engine, real_time
        self.clock: Any = time if real_time else None
        self._kind: ObjectName = task
        self._seed, self._orientation_deg = seed, orientation_deg
        self._steps, self._truth_path = PHYSICS_HZ // rate_hz, truth_path
        self._pinch = read_pinch(hand)
        self._skin = TactileSkin(self._pinch)
        self._drawer = Drawer(ranges_for(task, ranges), task, self._pinch, self._skin.taxels)
        self._grasp = Grasp(self._pinch, self._drawer.nominal, GraspOptions())
        truth_rng, effect_rng = np.random.default_rng([seed, 0]).spawn(2)
        self._truth, self._sample = self._drawer.episode(truth_rng)
        # Whoever puts an object between the fingers knows its size.
        radius = f"object.{task}.radius_m"
        self._truth |= {radius: self._drawer.nominal[radius]} | self._hidden(effects or {}, effect_rng)
        self._scene: Scene | None = None
        self._moving, self._halted = threading.Lock(), threading.Event()

    @property
    def description(self) -> HandDescription:
        """The hand."""
        return self._pinch.description

    @property
    def period_s(self) -> float:
        """Time between two states [s]."""
        return self._steps / PHYSICS_HZ

    @property
    def object_width_m(self) -> float:
        """Width of the object [m]."""
        return 2 * number(self._truth, f"object.{self._kind}.radius_m")

    @property
    def truth(self) -> dict[str, Any]:
        """All that was drawn, by full name, as plain numbers and lists."""
        return {name: np.asarray(value).tolist() for name, value in sorted(self._truth.items())}

    def _hidden(self, effects: Mapping[str, float], rng: np.random.Generator) -> Values:
        """Return parameters of the effects by full name."""
        found: Values = {}
        for name, strength in effects.items():
            known = [one for one in EFFECTS if one not in RIG_EFFECTS]
            if name not in known:
                expected = f"effects of the skin: {', '.join(known)}"
                raise input_error('driver "reference", option effects', expected, f'"{name}"')
            drawn = EFFECTS[name].at_strength(strength, rng, self._skin.layout)
            for key, value in drawn.items():
                found[f"skin.effects.{name}.{key}"] = float(value) if np.ndim(value) == 0 else value
        return found

    def connect(self) -> None:
        """The fingers stand open about the object, which a person holds."""
        self._halted.clear()
        if self._scene is not None:
            return
        self._rng = np.random.default_rng([self._seed, 1])
        values = self._truth
        self._body = body_of(self._kind, values)
        self._sensor = Sensor.of(self._pinch, values)
        scene = make_scene(self._engine, self._pinch, _SOLVER_ITERATIONS)
        place = array(values, f"object.{self._kind}.position_m")
        turn = turn_of(self._kind, values, self._orientation_deg)
        width = self._grasp.open(scene, values, self._body, turn, place)
        self._desired = self._grasp.posture(width)
        self._skin.begin(values, self._sensor.pose, self._body, drawn_age_s(self._rng))
        # A driver's guard gives observe() little time, and compiling takes seconds.
        self._skin.prepare()
        self._scene, self._periods, self._touched_s = scene, 0, 0.0
        if self.clock is not None:
            self._began_s = self.clock.monotonic()
        if self._truth_path is not None:
            text = json.dumps({"format": TRUTH_FORMAT, "seed": self._seed, "values": self.truth}, indent=1)
            with whole_file(self._truth_path, force=True, mark=TRUTH_FORMAT) as file:
                file.write_text(text + "\n", encoding="utf-8")

    @property
    def _connected(self) -> Scene:
        if self._scene is None:
            raise HandError('driver "reference": expected a hand that is connected', "order")
        return self._scene

    def observe(self) -> HandState:
        """Move on by one period, or to the present of a clock that it keeps pace with; say what the sensors say."""
        scene = self._connected
        self._move_on(scene, least=1)
        time_s = self._periods * self.period_s
        noise = self._drawer.step(self._rng, self._sample)
        weight = self._body.mass_kg * self._pinch.gravity_m_per_s2
        push = noise.get(f"object.{self._kind}.random_force_n", 0.0)
        scene.force_n = np.broadcast_to(weight + push, 3).tolist()
        self._view = view(scene, self._sensor)
        taxel_noise = np.asarray(noise.get("skin.taxel_noise_counts", 0.0))
        image = self._skin.image(self._view.skin_contact(self._body), time_s, taxel_noise)
        offset = array(self._truth, "finger.joint_offset_rad")
        drives = scene.drives
        return HandState(
            time_s=time_s,
            q_rad=drives.motor_rad + offset + noise.get("finger.joint_noise_rad", 0.0),
            dq_rad_per_s=drives.speed_rad_per_s.copy(),
            tau_nm=drives.torque_nm.copy(),
            q_desired_rad=self._desired.copy(),
            taxels=image,
            taxel_time_s=np.full(len(image), time_s),
        )

    def _move_on(self, scene: Scene, least: int) -> None:
        """Move on by so many periods at least: as many as have passed of the clock that it keeps pace with."""
        periods = max(least, self._due())
        with self._moving:
            if self._halted.is_set():
                self._hold(scene)
            scene.run(periods * self._steps)
        if self.clock is not None:
            self.clock.sleep(max(0.0, (self._periods + periods) * self.period_s - self._passed_s()))
        self._periods += periods
        self._let_go(scene, periods * self.period_s)

    def _due(self) -> int:
        """Return whole periods that have passed of the clock, and have not been simulated."""
        return 0 if self.clock is None else int(self._passed_s() / self.period_s + 1e-6) - self._periods

    def _passed_s(self) -> float:
        return self.clock.monotonic() - self._began_s

    def _let_go(self, scene: Scene, passed_s: float) -> None:
        """The person who holds the object lets go when both fingers have it."""
        if not scene.held:
            return
        self._touched_s = self._touched_s + passed_s if None not in scene.touches() else 0.0
        if self._touched_s >= _RELEASE_S:
            scene.release()

    def act(self, command: HandCommand) -> None:
        """Hold to other angles from now on; a hand that has been stopped stays so until it is connected again."""
        scene = self._connected
        # What came before this command went by another.
        self._move_on(scene, least=0)
        if not self._halted.is_set():
            self._desired = np.array(command.q_desired_rad, dtype=np.float64)
            offset = array(self._truth, "finger.joint_offset_rad")
            scene.drives.target_rad = self._desired - offset

    def object_position_m(self) -> FloatArray | None:
        seen: View | None = getattr(self, "_view", None)
        return None if seen is None or seen.dropped else seen.position_m.copy()

    def _hold(self, scene: Scene) -> None:
        scene.drives.hold()
        self._desired = scene.drives.motor_rad + array(self._truth, "finger.joint_offset_rad")

    def stop(self) -> None:
        """Hold to where the motors are."""
        self._halted.set()
        if self._scene is not None and self._moving.acquire(blocking=False):
            try:
                self._hold(self._scene)
            finally:
                self._moving.release()

    def close(self) -> None:
        """End the session."""
        scene, self._scene = self._scene, None
        if scene is not None:
            scene.close()
