"""Environments for tests; what is made is closed when the test is over."""

from __future__ import annotations

from typing import Any

import gymnasium

import skincal.envs  # noqa: F401  # registers the tasks

MARBLE, BOLT, PELLETS = "skincal/MarbleRoll-v0", "skincal/BoltRoll-v0", "skincal/PelletSeparate-v0"
made: list[Any] = []


def make(name: str = MARBLE, **arguments: Any) -> Any:
    made.append(gymnasium.make(name, disable_env_checker=True, **arguments).unwrapped)
    return made[-1]
