"""Description in a policy file."""

from __future__ import annotations

from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from gymnasium import spaces

from skincal.ranges import Ranges
from skincal.ranges.plain import digest
from skincal.train.learner import ACTOR_KEY, Learner
from skincal.train.policy_file import Description
from skincal.train.settings import Work

PACKAGES = ("skincal", "gymnasium", "numpy", "pybullet", "stable-baselines3", "torch", "sbx-rl", "jax")


def describe(work: Work, ranges: Ranges, learner: Learner, steps: int, wall_s: float) -> Description:
    """Return the description of a run's policy."""
    return Description(
        task=work.task,
        policy=work.policy,
        observation=_layout(learner),
        actions=spaces.flatdim(learner.model.action_space),
        ranges_sha256=digest(ranges),
        seed=work.seed,
        steps=steps,
        wall_time_s=round(wall_s, 1),
        backend=str(work.backend),
        environment=work.environment,
        versions=_versions(),
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        start=work.start,
    )


def _layout(learner: Learner) -> tuple[dict[str, Any], ...]:
    """Return the parts of the policy's observation: as the environment tells them, or one for all."""
    environments = learner.normalised
    if environments.has_attr("observation_layout"):
        return tuple(dict(part) for part in environments.get_attr("observation_layout", 0)[0])
    space = learner.normalised.observation_space
    assert isinstance(space, spaces.Dict)
    return ({"name": ACTOR_KEY, "size": spaces.flatdim(space[ACTOR_KEY])},)


def _versions() -> dict[str, str]:
    found: dict[str, str] = {}
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found
