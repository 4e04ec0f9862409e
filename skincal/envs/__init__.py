"""Gymnasium tasks: a marble and a bolt that are rolled between two fingertips, and pellets that are let go one by one.

Importing this package registers ``skincal/MarbleRoll-v0``, ``skincal/BoltRoll-v0`` and ``skincal/PelletSeparate-v0``;
the classes are loaded when they are asked for.
"""

from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from skincal.envs.bolt import BoltRollEnv
    from skincal.envs.episode_options import JOINT_OFFSETS, EpisodeOptions
    from skincal.envs.grasp import GraspOptions
    from skincal.envs.marble import MarbleRollEnv
    from skincal.envs.pellets import PelletSeparateEnv
    from skincal.envs.registration import ENVIRONMENTS, register_environments
    from skincal.envs.rewards import RewardScales
    from skincal.envs.roll import RollEnv
    from skincal.envs.task import TaskOptions
    from skincal.envs.trajectories import ORIENTATIONS_DEG

if find_spec("gymnasium") is not None:
    from skincal.envs.registration import register_environments

    register_environments()

_HOMES = {
    "BoltRollEnv": "bolt",
    "ENVIRONMENTS": "registration",
    "EpisodeOptions": "episode_options",
    "GraspOptions": "grasp",
    "JOINT_OFFSETS": "episode_options",
    "MarbleRollEnv": "marble",
    "ORIENTATIONS_DEG": "trajectories",
    "PelletSeparateEnv": "pellets",
    "RewardScales": "rewards",
    "RollEnv": "roll",
    "TaskOptions": "task",
    "register_environments": "registration",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__} has no attribute {name}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)


__all__ = [
    "ENVIRONMENTS",
    "JOINT_OFFSETS",
    "ORIENTATIONS_DEG",
    "BoltRollEnv",
    "EpisodeOptions",
    "GraspOptions",
    "MarbleRollEnv",
    "PelletSeparateEnv",
    "RewardScales",
    "RollEnv",
    "TaskOptions",
    "register_environments",
]
