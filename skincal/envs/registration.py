"""Names by which Gymnasium finds the tasks; the tasks themselves are loaded when one is made."""

from __future__ import annotations

try:
    from gymnasium.envs.registration import (
        register,  # pyright: ignore[reportUnknownVariableType]
        registry,
    )
except ModuleNotFoundError as error:
    raise ModuleNotFoundError(
        "skincal.envs needs Gymnasium: pip install 'skincal[policy]'", name=error.name
    ) from error

from skincal.tasks import ENVIRONMENT_IDS, Task

ENVIRONMENTS = {
    ENVIRONMENT_IDS[Task.marble]: "skincal.envs.marble:MarbleRollEnv",
    ENVIRONMENT_IDS[Task.bolt]: "skincal.envs.bolt:BoltRollEnv",
    ENVIRONMENT_IDS[Task.pellets]: "skincal.envs.pellets:PelletSeparateEnv",
}
"""Entry points by name."""


def register_environments() -> None:
    """Register all tasks with Gymnasium; may be called twice."""
    for name, entry in ENVIRONMENTS.items():
        if name not in registry:
            register(id=name, entry_point=entry)
