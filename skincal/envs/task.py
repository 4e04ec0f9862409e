"""Options of a task."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from numbers import Integral, Real
from typing import Any, cast

from skincal.dataset.findings import did_you_mean
from skincal.envs.grasp import GraspOptions
from skincal.envs.rewards import RewardScales
from skincal.errors import InputError, Problem


@dataclass(frozen=True)
class TaskOptions:
    """Options of a task.

    Attributes:
        duration_s: time-out of an episode [s].
        speed_rad_per_s: joint velocity that an action of 1 commands, the largest there is; assumed [rad/s].
        box_half_m: half the width of the box in which random targets lie [m].
        resolution_m: longest edge of a tactile point's cell [m].
        solver_iterations: of PyBullet's contact solver in each step of 1 ms. More are slower, and nearer to what 1000
            give; ``benchmarks/solver_iterations.py`` says by how much.
        rewards: weights and widths.
        grasp: how the object is taken.
    """

    duration_s: float = 6.0
    speed_rad_per_s: float = 0.3
    box_half_m: float = 6e-3
    resolution_m: float = 0.25e-3
    solver_iterations: int = 20
    rewards: RewardScales = field(default_factory=RewardScales)
    grasp: GraspOptions = field(default_factory=GraspOptions)

    @property
    def numbers(self) -> dict[str, float]:
        """All but rewards and grasp, by name, as an environment takes them singly."""
        values = {item.name: getattr(self, item.name) for item in fields(self)}
        return {name: value for name, value in values.items() if name not in _TABLES}


def with_single(options: TaskOptions, single: Mapping[str, Any]) -> TaskOptions:
    """Return options with single ones in the place of others.

    Raises:
        InputError: unknown names, or values that make no sense; all of them.
    """
    known = [item.name for item in fields(TaskOptions)]
    found: list[Problem] = []
    for name, value in single.items():
        if name not in known:
            close = did_you_mean(name, known)
            fix = f'Did you mean "{close}"?' if close else ""
            expected = f"one of {', '.join(known)}"
            found.append(Problem(f"environment {name}", expected, "an unknown argument", fix))
        elif not _fits(name, value):
            found.append(Problem(f"environment {name}", _EXPECTED.get(name, "a number > 0"), repr(value)))
    if found:
        raise InputError(found)
    return replace(options, **single)


_TABLES = ("rewards", "grasp")
_EXPECTED = {
    "rewards": "RewardScales",
    "grasp": "GraspOptions",
    "solver_iterations": "a whole number > 0, below 10000",
}


def _fits(name: str, value: object) -> bool:
    if name in _TABLES:
        return isinstance(value, RewardScales if name == "rewards" else GraspOptions)
    if isinstance(value, bool):
        return False
    number = isinstance(value, Integral if name == "solver_iterations" else Real)
    return number and 0 < cast(float, value) < 1e4
