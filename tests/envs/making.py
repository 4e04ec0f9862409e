"""Environments for tests, closed when the test is over, and a controller that shows that a task can be done."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np

import skincal.envs  # noqa: F401  # registers the tasks

MARBLE, BOLT, PELLETS = "skincal/MarbleRoll-v0", "skincal/BoltRoll-v0", "skincal/PelletSeparate-v0"
made: list[Any] = []


def make(name: str = MARBLE, **arguments: Any) -> Any:
    made.append(gymnasium.make(name, disable_env_checker=True, **arguments).unwrapped)
    return made[-1]


def rolling(env: Any, to_m: np.ndarray, *, force_gain_m_per_n: float = 0.002) -> np.ndarray:
    """The action that rolls the object to a place on the sensor (2,) [m], and presses with 1.5 N.

    The object goes half as far as the tips move against each other; each of them takes half of that.
    """
    seen = env.truth
    if seen.skin is None or seen.thumb is None:
        return np.zeros(env.action_space.shape)
    chains, sensor = env.pinch.kinematics, env.world.sensor
    u, v = to_m - seen.position_m
    cos, sin = np.cos(sensor.pose.alpha_rad), np.sin(sensor.pose.alpha_rad)
    normal, along = np.array(seen.skin.normal), seen.tip.rotation[:, 1]
    across = np.cross(along, normal)
    across /= np.linalg.norm(across)
    # On a round finger the line of the centres turns as the object rolls.
    lever = 1 + env.world.body.radius_m / sensor.radius_m
    way = (u * cos - v * sin) * lever * across + (u * sin + v * cos) * along
    press = force_gain_m_per_n * (1.5 - (seen.skin.force_n + seen.thumb.force_n) / 2)
    skin, thumb = chains.frames(seen.q_rad)
    dq = np.zeros(env.pinch.joints)
    for chain, frames, touching, move in (
        (chains.skin, skin, seen.skin, -way),
        (chains.indenter, thumb, seen.thumb, way),
    ):
        jacobian = chain.jacobian(frames, np.array(touching.point_m)[None])[0]
        dq[chain.columns] = np.linalg.solve(jacobian, move + press * np.array(touching.normal))
    return np.clip(dq / (env.options.speed_rad_per_s / 10), -1, 1)
