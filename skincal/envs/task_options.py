"""Options of a task, and of an episode (``reset(options={...})``): each class is also the schema that checks them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Annotated, Any, Final, TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike

from skincal.dataset.findings import Findings
from skincal.dataset.keys import Key
from skincal.dataset.schema import Table, read_table
from skincal.envs.grasp import GraspOptions
from skincal.envs.rewards import RewardScales
from skincal.envs.trajectories import BOLT_HZ, FIXED
from skincal.tasks import SPEEDS_RAD_PER_S, Task

_TRAJECTORIES: Final = ("random", *FIXED)


class _Number(Key):
    """A number of Python or of numpy."""

    def _prepared(self, value: Any) -> Any:
        return cast(Any, value).item() if isinstance(value, np.generic) else value


class _Positive(_Number):
    def __init__(self, expected: str = "a number > 0") -> None:
        super().__init__(expected, 1e-12, 1e4)


class _Between(_Number):
    def __init__(self, low: float, high: float) -> None:
        super().__init__(f"a number between {low:g} and {high:g}", low, high)


class _Trajectory(Key):
    """One that has a name, or targets."""

    def _prepared(self, value: Any) -> Any:
        try:
            return value if isinstance(value, str) else np.array(value, dtype=np.float64)
        except TypeError as error:
            raise ValueError from error

    def _fault(self, value: Any) -> tuple[str, str] | None:
        if isinstance(value, str):
            good = value in _TRAJECTORIES
        else:
            good = value.ndim == 2 and value.shape[1] == 2 and len(value) and (np.abs(value) <= 0.05).all()
        return None if good else (self.expected, "")


class _Names(Key):
    """A list of names; all, or none, of them by a word."""

    def _prepared(self, value: Any) -> Any:
        known: dict[Any, tuple[str, ...] | None] = {"all": None, "none": ()}
        return known.get(value, value) if isinstance(value, str) else value


@dataclass(frozen=True)
class TaskOptions(Table, unknown="refuse"):
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

    duration_s: Annotated[float, _Positive()] = 6.0
    speed_rad_per_s: Annotated[float, _Positive()] = SPEEDS_RAD_PER_S[Task.marble]
    box_half_m: Annotated[float, _Positive()] = 6e-3
    resolution_m: Annotated[float, _Positive()] = 0.25e-3
    solver_iterations: Annotated[int, _Positive("a whole number > 0, below 10000")] = 20
    rewards: RewardScales = field(default_factory=RewardScales)
    grasp: GraspOptions = field(default_factory=GraspOptions)

    @property
    def numbers(self) -> dict[str, float]:
        """All but rewards and grasp, by name, as an environment takes them singly."""
        values = {item.name: getattr(self, item.name) for item in fields(self)}
        return {name: value for name, value in values.items() if name not in ("rewards", "grasp")}


@dataclass(frozen=True)
class EpisodeOptions(Table, unknown="refuse"):
    """Options of an episode.

    Attributes:
        trajectory: of the marble: ``random``, ``circle`` (the evaluation), ``still``, or targets (N, 2) in patch
            coordinates at 10 Hz [m], the last of which stays.
        duration_s: the time-out [s]; None: 6 s, of the circle 8 s.
        randomize: ``all``, ``none``, or names of parameters and tables that are randomized, the rest being nominal.
        values: values by full name that take the place of draws.
        orientation_deg: of the bolt [°]; None: drawn from the four.
        frequency_hz: of the bolt's sine [Hz]; None: drawn.
        pellets: how many there are; None: drawn.
    """

    trajectory: Annotated[
        Any, _Trajectory(f"one of {', '.join(_TRAJECTORIES)}, or targets (N, 2) within 0.05 m")
    ] = "random"
    duration_s: Annotated[float | None, _Between(0.1, 3600.0)] = None
    randomize: Annotated[
        tuple[str, ...] | None, _Names('"all", "none", or a list of names of parameters and tables')
    ] = None
    values: Annotated[Mapping[str, Any], Key("values by full name: {'skin.y_m': 0.0235}")] = field(
        default_factory=dict[str, ArrayLike]
    )
    orientation_deg: Annotated[float | None, _Between(-360.0, 360.0)] = None
    frequency_hz: Annotated[float | None, _Between(0.0, 10 * BOLT_HZ[1])] = None
    pellets: Annotated[float | None, _Between(2, 3)] = None


Options = TypeVar("Options", TaskOptions, EpisodeOptions)


def read_options(kind: type[Options], given: Mapping[str, Any], place: str) -> Options:
    """Return options from a mapping of names and values.

    Raises:
        InputError: unknown keys, or values that make no sense; all of them.
    """
    findings = Findings()
    found = read_table(kind, given, findings, place)
    findings.raise_errors()
    return found
