"""A simulated hand with an object between its fingers and a hidden truth, as a driver: a policy's dress rehearsal.

What the policy's simulation randomizes is drawn here once and kept hidden: pose, elasticity, scale, gains, friction,
joint offsets; and the skin may have effects that no calibration has been told of. A person who holds the object until
both fingers have it is part of the simulation.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from skincal.effects import EFFECTS
from skincal.envs.bodies import BODIES, body_of, turn_of
from skincal.envs.drawing import RIG_EFFECTS, Values, array, number, ranges_for
from skincal.envs.pinch import read_pinch
from skincal.envs.scene import PHYSICS_HZ, Scene, check_engine, make_scene
from skincal.envs.tactile import drawn_age_s
from skincal.envs.world import View, World
from skincal.errors import input_error
from skincal.hand.driver import HandCommand, HandState
from skincal.hand.errors import HandError
from skincal.hand.sim import SimulatedDriver, write_truth
from skincal.model.arrays import FloatArray
from skincal.ranges import Ranges
from skincal.robot import HandDescription

TRUTH_FORMAT = "skincal-reference-truth/1"
_RELEASE_S = 0.25
"""The person lets go when both fingers have touched the object for so long [s]."""
_SOLVER_ITERATIONS = 50


class ReferenceHand(SimulatedDriver):
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
        check_engine(engine, 'driver "reference", option engine')
        super().__init__(rate_hz, PHYSICS_HZ)
        self._engine, self.real_time = engine, real_time
        self.clock: Any = time if real_time else None
        self._seed, self._orientation_deg, self._truth_path = seed, orientation_deg, truth_path
        self._world = World(read_pinch(hand), task, ranges_for(task, ranges))
        truth_rng, effect_rng = np.random.default_rng([seed, 0]).spawn(2)
        self._truth, self._sample = self._world.drawer.episode(truth_rng)
        # Whoever puts an object between the fingers knows its size.
        radius = f"object.{task}.radius_m"
        self._truth[radius] = self._world.drawer.nominal[radius]
        self._truth |= self._hidden(effects or {}, effect_rng)
        self._view: View | None = None

    @property
    def description(self) -> HandDescription:
        """The hand."""
        return self._world.pinch.description

    @property
    def object_width_m(self) -> float:
        """Width of the object [m]."""
        return 2 * number(self._truth, f"object.{self._world.kind}.radius_m")

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
            drawn = EFFECTS[name].at_strength(strength, rng, self._world.skin.layout)
            for key, value in drawn.items():
                found[f"skin.effects.{name}.{key}"] = float(value) if np.ndim(value) == 0 else value
        return found

    def connect(self) -> None:
        """Begin with the fingers open about the object, which a person holds."""
        self._halted.clear()
        world, values = self._world, self._truth
        if world.scene is not None:
            return
        self._rng = np.random.default_rng([self._seed, 1])
        world.begin(values, body_of(world.kind, values))
        world.scene = make_scene(self._engine, world.pinch, _SOLVER_ITERATIONS)
        place = array(values, f"object.{world.kind}.position_m")
        turn = turn_of(world.kind, values, self._orientation_deg)
        width = world.grasp.open(world.scene, values, world.body, turn, place)
        self._desired = world.grasp.postures.at(width)
        world.begin_skin(drawn_age_s(self._rng))
        # A driver's guard gives observe() little time, and compiling takes seconds.
        world.skin.prepare()
        self._periods, self._touched_s = 0, 0.0
        if self.clock is not None:
            self._began_s = self.clock.monotonic()
        if self._truth_path is not None:
            write_truth(self._truth_path, TRUTH_FORMAT, {"seed": self._seed, "values": self.truth})

    @property
    def _connected(self) -> Scene:
        if self._world.scene is None:
            raise HandError('driver "reference": expected a hand that is connected', "order")
        return self._world.scene

    def observe(self) -> HandState:
        """Advance by one period, or to the present of its clock, and return the sensors' readings."""
        world, scene = self._world, self._connected
        self._move_on(scene, least=1)
        time_s = self._periods * self.period_s
        world.noise = world.drawer.step(self._rng, self._sample)
        world.push()
        self._view = world.look()
        image = world.image(self._view.skin_contact(world.body), time_s)
        drives = scene.drives
        return HandState(
            time_s=time_s,
            q_rad=world.measured_rad(),
            dq_rad_per_s=drives.speed_rad_per_s.copy(),
            tau_nm=drives.torque_nm.copy(),
            q_desired_rad=self._desired.copy(),
            taxels=image,
            taxel_time_s=np.full(len(image), time_s),
        )

    def _move_on(self, scene: Scene, least: int) -> None:
        """Move on by so many periods at least: as many as have passed of the clock that it keeps pace with."""
        periods = max(least, self._due())
        with self._simulating():
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
        """Command other joint angles; a stopped hand ignores them until it is connected again."""
        scene = self._connected
        # Time up to now passed under the previous command.
        self._move_on(scene, least=0)
        if not self._halted.is_set():
            self._desired = np.array(command.q_desired_rad, dtype=np.float64)
            self._world.command(self._desired)

    def object_position_m(self) -> FloatArray | None:
        view = self._view
        return None if view is None or view.dropped else view.position_m.copy()

    def _hold(self) -> None:
        scene = self._world.scene
        if scene is not None:
            scene.drives.hold()
            self._desired = scene.drives.motor_rad + self._world.offset_rad

    def close(self) -> None:
        """End the session."""
        self._world.close()
