"""Base of all tasks with objects between two fingertips (Kasolowsky & Bäuml, IROS 2024, section IV)."""

from __future__ import annotations

import math
from abc import abstractmethod
from copy import copy
from pathlib import Path
from typing import Any, ClassVar, cast

import gymnasium
import numpy as np
from gymnasium.utils import EzPickle
from numpy.typing import ArrayLike, NDArray

from skincal.envs.bodies import Body, body_of
from skincal.envs.bullet_scene import BulletScene
from skincal.envs.drawing import Values, array, is_chosen, ranges_for
from skincal.envs.observations import KINDS, Observation, ObservationStack, state_values
from skincal.envs.picture import Board, Picture, PictureState, display_there, picture
from skincal.envs.pinch import Pinch, read_pinch
from skincal.envs.rewards import reward_terms
from skincal.envs.scene import PHYSICS_HZ, Scene, check_engine, make_scene
from skincal.envs.tactile import SkinContact, drawn_age_s
from skincal.envs.task_options import EpisodeOptions, TaskOptions, read_options
from skincal.envs.trajectories import POLICY_HZ
from skincal.envs.world import View, World
from skincal.errors import input_error
from skincal.model.arrays import FloatArray
from skincal.ranges import Ranges
from skincal.tasks import OBJECTS, TASK_PRESETS, ObjectName, PolicyKind, Task

AHEAD: tuple[int, ...] = (5, 10)
"""The critic sees the targets so many steps ahead."""
_HOLD_STEPS = 10
"""While the object is held, physics steps between looks for contact."""


class RollEnv(gymnasium.Env[Observation, NDArray[np.float32]], EzPickle):
    """Environment with an object between two fingertips that is moved along a target.

    An action in [-1, 1]^n is a change of the commanded joint angles, in parts of the largest velocity times 0.1 s. The
    observation holds ``policy``, what the policy sees, and ``critic``, what the critic may see besides, neither of them
    normalized. See the page on environments for every number in them.

    Args:
        policy: ``tactile``, ``joint-angles``, ``desired`` or ``ideal``: kind of observation.
        ranges: what is randomized: ranges, a file of them, the name of a preset, or None: the task's preset.
        hand: folder with ``hand.toml`` and ``pinch.toml``; None: the bundled hand.
        render_mode: ``rgb_array``, ``human`` or None.
        options: of the task; single ones may be given by their names.
        engine: the physics: ``pybullet`` or ``mujoco``; only the first makes pictures.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array", "human"], "render_fps": POLICY_HZ}  # noqa: RUF012
    task: ClassVar[Task]
    target_size: ClassVar[int]
    target_limit: ClassVar[float] = 0.05
    """Beyond this a target is cut off."""
    objects: ClassVar[int] = 1
    """Most objects that there can be."""
    own_size: ClassVar[int] = 0
    """How many numbers the critic sees that a task alone has."""

    def __init__(
        self,
        policy: PolicyKind | str = PolicyKind.tactile,
        ranges: Ranges | str | Path | None = None,
        hand: str | Path | None = None,
        render_mode: str | None = None,
        options: TaskOptions | None = None,
        engine: str = "pybullet",
        **single: Any,
    ) -> None:
        # A pickle holds the arguments only: the copy has to be reset.
        EzPickle.__init__(self, policy, ranges, hand, render_mode, options, engine, **single)
        if policy not in KINDS:
            raise input_error("policy", f"one of {', '.join(KINDS)}", repr(policy))
        check_engine(engine, "environment engine")
        if render_mode is not None and engine != "pybullet":
            raise input_error(
                "environment render_mode", f"None: {engine} makes no pictures", repr(render_mode)
            )
        self.policy = PolicyKind(policy)
        self.engine = engine
        own = options or self.default_options()
        self.options = read_options(TaskOptions, {**vars(own), **single}, "environment")
        self.render_mode = render_mode
        self._object: ObjectName = OBJECTS[self.task]
        self.ranges = ranges_for(self._object, TASK_PRESETS[self.task] if ranges is None else ranges)
        self.pinch: Pinch = read_pinch(hand)
        self.world = World(
            self.pinch, self._object, self.ranges, self.options.grasp, self.options.resolution_m
        )
        self.skin = self.world.skin
        n = self.pinch.joints
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (n,), np.float32)
        self._observation = ObservationStack(
            self.policy, self.world.drawer.nominal, joints=n, taxels=self.skin.taxels, counts=self.skin.range_counts,
            objects=self.objects, target=self.target_size, limit=self.target_limit, ahead=len(AHEAD),
            own=self.own_size,
        )  # fmt: skip
        self.observation_space = cast("gymnasium.Space[Observation]", self._observation.space)

    @property
    def observation_layout(self) -> tuple[dict[str, Any], ...]:
        """The parts of the policy's observation in their order: ``name``, ``size``, and ``steps_ago``."""
        return self._observation.layout()

    @classmethod
    def default_options(cls) -> TaskOptions:
        """Return options that are not given."""
        return TaskOptions()

    def _body(self, values: Values) -> Body:
        return body_of(self._object, values)

    def _initial_positions_m(self, values: Values) -> list[FloatArray]:
        """Return the initial position of each object (3,), from the middle between the tips, fingertip frame [m]."""
        return [array(values, f"object.{self._object}.position_m")]

    def _initial_rotation(self, values: Values) -> FloatArray:
        """Return the object's initial rotation (3, 3) in the fingertip's frame."""
        return np.eye(3)

    @abstractmethod
    def _plan_targets(self, steps: int) -> FloatArray:
        """Return targets (steps, target_size) as the policy sees them [m]."""

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode with options of :class:`skincal.envs.EpisodeOptions`.

        Raises:
            InputError: options that make no sense.
        """
        super().reset(seed=seed)
        episode = read_options(EpisodeOptions, options or {}, "options")
        self.world.drawer.check(episode.randomize or (), episode.values)
        self._episode = episode
        self._begin()
        self._draw_noise()
        self._look()
        observation = self._observe()
        self._show()
        return observation, self._info({})

    def _begin(self) -> None:
        """Draw an episode, and take the object."""
        world, episode = self.world, self._episode
        values, self._sample = world.drawer.episode(self.np_random, episode.randomize, episode.values)
        age = drawn_age_s(self.np_random)
        self._age_s = age if is_chosen("skin", episode.randomize) else 0.0
        if self.policy is not PolicyKind.tactile:
            # Policies without touch cannot know where the sensor is: it stays at the middle of its range.
            for name in ("y_m", "beta_deg", "alpha_deg", "x_offset_m", "y_offset_m"):
                if (path := f"skin.{name}") not in episode.values:
                    values[path] = world.drawer.nominal[path]
        world.begin(values, self._body(values))
        self._step, self._steps = 0, max(1, round(self._duration_s() * POLICY_HZ))
        rotation = self._initial_rotation(values)
        self._set_targets(self._plan_targets(self._steps + 1 + max(AHEAD)))
        if world.scene is None:
            window = self.render_mode == "human" and display_there()
            visible, iterations = self.render_mode is not None, self.options.solver_iterations
            world.scene = make_scene(self.engine, self.pinch, iterations, window=window, visible=visible)
        places = self._initial_positions_m(values)
        command = world.grasp.take(world.scene, values, world.body, rotation, *places)
        self._desired = self._clipped(command)
        if self.policy is PolicyKind.tactile:
            world.begin_skin(self._age_s)
        self._observation.begin(values)

    def _set_targets(self, targets_m: FloatArray) -> None:
        """Set the targets (steps, target_size), their changes, and how those ahead differ from them."""
        k = np.arange(len(targets_m))
        self._targets = targets_m
        self._movements = targets_m - targets_m[np.maximum(k - 1, 0)]
        ahead = [targets_m[np.minimum(k + a, len(k) - 1)] - targets_m for a in AHEAD]
        self._ahead = np.concatenate(ahead, axis=1)

    def _duration_s(self) -> float:
        asked_s = self._episode.duration_s
        return self.options.duration_s if asked_s is None else asked_s

    def _clipped(self, q_rad: FloatArray) -> FloatArray:
        limits = self.pinch.description.limits
        return np.minimum(np.maximum(q_rad, limits.lower_rad), limits.upper_rad)

    def step(self, action: NDArray[np.float32]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Move on by 0.1 s.

        Args:
            action: (n,) in [-1, 1]; clipped; NaN counts as 0.
        """
        scene = self.world.scene
        if scene is None:
            raise gymnasium.error.ResetNeeded("Cannot call env.step() before calling env.reset()")
        wanted = np.array(action, dtype=np.float64)
        wanted[np.isnan(wanted)] = 0.0
        wanted = np.minimum(np.maximum(wanted, -1.0), 1.0)
        self._desired = self._clipped(self._desired + wanted * self.options.speed_rad_per_s / POLICY_HZ)
        self.world.command(self._desired)
        self._draw_noise()
        self.world.push()
        before = self._view.q_rad
        self._run(scene)
        self._step += 1
        self._look()
        terms = self._reward_terms(before)
        terminated = self._dropped()
        truncated = not terminated and self._step >= self._steps
        observation = self._observe()
        self._show()
        return observation, float(sum(terms.values())), terminated, truncated, self._info(terms)

    def _run(self, scene: Scene) -> None:
        """0.1 s of physics; an object that is still held is let go when both fingers touch it."""
        steps = PHYSICS_HZ // POLICY_HZ
        while scene.held and steps > 0:
            scene.run(min(_HOLD_STEPS, steps))
            steps -= _HOLD_STEPS
            if None not in scene.touches():
                scene.release()
        scene.run(max(steps, 0))

    def _draw_noise(self) -> None:
        episode = self._episode
        self.world.noise = self.world.drawer.step(
            self.np_random, self._sample, episode.randomize, episode.values
        )

    def _look(self) -> None:
        self._view: View = self.world.look()

    def _dropped(self) -> bool:
        return self._view.dropped

    def _present_views(self) -> list[View]:
        """Return the view of each object that is still there."""
        return [self._view]

    def _contact_truth(self) -> FloatArray:
        """Return position on the sensor [m] and force [N] of each object (3 M,), 0 where it does not touch."""
        found = np.zeros((self.objects, 3))
        for row, view in zip(found, self._present_views(), strict=False):
            if view.skin is not None and view.sound:
                row[:] = *view.position_m, view.skin.force_n
        return found.ravel()

    def _own(self) -> FloatArray:
        """Return critic observations of this task alone (own_size,)."""
        return np.zeros(0)

    def _target_m(self) -> FloatArray:
        """Return the target (2,) at this moment, patch coordinates [m]."""
        return self._targets[self._step]

    def _angle_rad(self) -> float | None:
        """Return the object's rotation on the sensor [rad]; None: the task has none."""
        return None

    def _reward_terms(self, before_rad: FloatArray) -> dict[str, float]:
        view, limits = self._view, self.pinch.description.limits
        margin = self.options.rewards
        speed = np.abs(view.q_rad - before_rad) * POLICY_HZ / self.options.speed_rad_per_s
        torque = np.abs(self.world.running.drives.torque_nm) / limits.torque_nm
        past = np.maximum(view.q_rad - limits.upper_rad, limits.lower_rad - view.q_rad)
        return reward_terms(
            margin,
            distance_m=self._error_m() if view.sound else np.inf,
            force_n=view.skin.force_n if view.skin else 0.0,
            right_contact=view.right_contact(self.pinch),
            past_joint_rad=_worst(past) + margin.joint_margin_rad,
            past_speed=_worst(speed) - 1 + margin.speed_margin,
            past_torque=_worst(torque) - 1 + margin.torque_margin,
            angle_rad=self._angle_rad(),
        )

    def _error_m(self) -> float:
        away = self._target_m() - self._view.position_m
        return math.sqrt(away @ away)

    def _observe(self) -> Observation:
        view, k = self._view, self._step
        motor, measured = self.world.running.drives.motor_rad.copy(), self.world.measured_rad()
        values: dict[str, Any] = {
            "desired": self._desired,
            "measured": measured,
            "error": self._desired - measured,
            "target": self._targets[k],
            "movement": self._movements[k],
        }
        if self.policy is PolicyKind.ideal:
            values["truth"] = self._contact_truth()
        if self.policy is PolicyKind.tactile:
            self.image = self.world.image(self.skin_contact(), k / POLICY_HZ)
            values["image"] = self.image
        target = self._target_m()
        own: dict[str, ArrayLike] = {
            **values,
            "motor": motor,
            "true_error": self._desired - self.world.offset_rad - view.q_rad,
            "to_target": target - view.position_m,
            "distance": self._error_m(),
            "ahead": self._ahead[k],
            "orientation": self._orientation(),
            "own": self._own(),
        }
        return self._observation.observe(values, state_values(view, own))

    def skin_contact(self) -> SkinContact | None:
        """Return the present contact as the skin takes it; None where nothing touches."""
        return self._view.skin_contact(self.world.body)

    @property
    def ignored_ranges(self) -> tuple[str, ...]:
        """Parameters of the ranges that are not used: effects of the rig that measured, not of the skin."""
        return self.world.drawer.ignored

    @property
    def truth(self) -> View:
        """Return the true state at this moment."""
        return self._view

    def _orientation(self) -> FloatArray:
        """Return the orientation that the critic observes (4,); zeros for a marble."""
        return np.zeros(4)

    def _info(self, terms: dict[str, float]) -> dict[str, Any]:
        view = self._view
        ended = self._step >= self._steps
        return {
            "time_s": self._step / POLICY_HZ,
            "error_m": self._error_m(),
            "position_m": view.position_m.copy(),
            "target_m": np.array(self._target_m()),
            "force_n": view.skin.force_n if view.skin else 0.0,
            "held": view.held,
            "drop": self._dropped(),
            "success": ended and not self._dropped(),
            "reward_terms": dict(terms),
            "session_s": self._age_s,
            "randomized": {path: copy(value) for path, value in self.world.values.items()},
            "noise": {path: copy(value) for path, value in self.world.noise.items()},
        }

    def render(self) -> Picture | None:  # type: ignore[override]
        """Return the hand and beside it the sensor (360, 840, 3), in the mode ``rgb_array``; else None."""
        if self.render_mode != "rgb_array":
            return None
        scene = self.world.scene
        if scene is None:
            raise gymnasium.error.ResetNeeded("Cannot call env.render() before calling env.reset()")
        assert isinstance(scene, BulletScene)
        return picture(scene, self._shown())

    def _show(self) -> None:
        """Keep PyBullet's window, if there is one, up to date and at the pace of life."""
        scene = self.world.scene
        if isinstance(scene, BulletScene) and scene.window:
            if self._step == 0:
                self._board = Board(scene, self._shown())
            self._board.show(self._shown())

    def _shown(self) -> PictureState:
        return PictureState(
            centre_m=self.world.grasp.postures.middle_m,
            layout=self.skin.layout,
            image=self.image if self.policy is PolicyKind.tactile else None,
            target_m=self._target_m(),
            place_m=self._view.position_m,
        )

    def close(self) -> None:
        """End the physics; may be called twice."""
        self.world.close()


def _worst(values: FloatArray) -> float:
    """Return the largest value; one that is not finite counts as far beyond the limit."""
    worst = float(values.max())
    return worst if math.isfinite(worst) else float(np.where(np.isfinite(values), values, 1e3).max())
