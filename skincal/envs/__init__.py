"""Gymnasium tasks: a marble and a bolt that are rolled between two fingertips, and pellets that are let go one by one.

Importing this package registers ``skincal/MarbleRoll-v0``, ``skincal/BoltRoll-v0`` and ``skincal/PelletSeparate-v0``;
the classes are loaded when they are asked for.
"""

from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from skincal.tasks import ENVIRONMENT_IDS, JOINT_OFFSETS, Task

if TYPE_CHECKING:
    from skincal.envs.bolt import BoltRollEnv
    from skincal.envs.grasp import GraspOptions
    from skincal.envs.marble import MarbleRollEnv
    from skincal.envs.pellets import PelletSeparateEnv
    from skincal.envs.rewards import RewardScales
    from skincal.envs.roll import RollEnv
    from skincal.envs.task_options import EpisodeOptions, TaskOptions
    from skincal.envs.trajectories import ORIENTATIONS_DEG

ENVIRONMENTS = {
    ENVIRONMENT_IDS[Task.marble]: "skincal.envs.marble:MarbleRollEnv",
    ENVIRONMENT_IDS[Task.bolt]: "skincal.envs.bolt:BoltRollEnv",
    ENVIRONMENT_IDS[Task.pellets]: "skincal.envs.pellets:PelletSeparateEnv",
}
"""Entry points by name."""


def register_environments() -> None:
    """Register all tasks with Gymnasium; may be called twice."""
    try:
        registration: Any = import_module("gymnasium.envs.registration")
    except ModuleNotFoundError as error:
        text = "skincal.envs needs Gymnasium: pip install 'skincal[policy]'"
        raise ModuleNotFoundError(text, name=error.name) from error
    for name, entry in ENVIRONMENTS.items():
        if name not in registration.registry:
            registration.register(id=name, entry_point=entry)


if find_spec("gymnasium") is not None:
    register_environments()

_HOMES = {
    "bolt": "BoltRollEnv",
    "grasp": "GraspOptions",
    "marble": "MarbleRollEnv",
    "pellets": "PelletSeparateEnv",
    "rewards": "RewardScales",
    "roll": "RollEnv",
    "task_options": "EpisodeOptions TaskOptions",
    "trajectories": "ORIENTATIONS_DEG",
}


def __getattr__(name: str) -> Any:
    for module, names in _HOMES.items():
        if name in names.split():
            return getattr(import_module(f"{__name__}.{module}"), name)
    raise AttributeError(f"module {__name__} has no attribute {name}")


__all__ = [
    "ENVIRONMENTS", "JOINT_OFFSETS", "ORIENTATIONS_DEG", "BoltRollEnv", "EpisodeOptions", "GraspOptions",
    "MarbleRollEnv", "PelletSeparateEnv", "RewardScales", "RollEnv", "TaskOptions", "register_environments",
]  # fmt: skip
