"""A policy as bare numbers, read from a file and run: no learner and no pickle is needed, nothing in it is code."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any, Final, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skincal.bounded import UnreadableError, read_bytes
from skincal.dataset.keys import Key, Word
from skincal.dataset.schema import Table
from skincal.dataset.schema_errors import Violation
from skincal.errors import InputError, WorkError, input_error
from skincal.files import reason
from skincal.tasks import PolicyKind, Task

Array = NDArray[np.float32]

EPSILON = 1e-8
"""Added to a variance before its root is taken, as in training."""

FORMAT: Final = "skincal-policy/1"
DESCRIPTION_KEY: Final = "skincal"
"""The name in the file's metadata under which the description stands, as JSON."""

INPUT: Final = "observation"
OUTPUT: Final = "action"
LONGEST_AGO: Final = 1000
"""Steps that an observation may lie back: a hundred seconds."""

LARGEST_BYTES: Final = 50_000_000
"""A policy is half a megabyte; whatever is larger than this is none."""


_MOST: Final = 2**20
"""Length of an observation or an action that no policy has."""


@dataclass(frozen=True, eq=False)
class Network:
    """A perceptron with normalised inputs, ReLU between its layers, and tanh at its end.

    The action is the mean of the learned distribution; nothing random is left.

    Attributes:
        mean: of each observation value, shape (O,).
        scale: one over its standard deviation, shape (O,).
        clip: normalised observations are cut off here.
        weights: of the layers, shapes (inputs, outputs).
        biases: of the layers, shapes (outputs,).
    """

    mean: Array
    scale: Array
    clip: float
    weights: tuple[Array, ...]
    biases: tuple[Array, ...]

    @classmethod
    def build(
        cls, mean: ArrayLike, variance: ArrayLike, clip: float, layers: Sequence[tuple[ArrayLike, ArrayLike]]
    ) -> Network:
        """Make one from running statistics and (weight, bias) of the layers."""
        variance = np.asarray(variance, dtype=np.float64)
        return cls(
            _frozen(mean),
            _frozen(1.0 / np.sqrt(variance + EPSILON)),
            float(clip),
            tuple(_frozen(weight) for weight, _ in layers),
            tuple(_frozen(bias) for _, bias in layers),
        )

    @property
    def observations(self) -> int:
        """Length O of an observation."""
        return len(self.mean)

    @property
    def actions(self) -> int:
        """Length A of an action."""
        return len(self.biases[-1])

    def __call__(self, observation: ArrayLike) -> Array:
        """Return the actions (N, A) in [-1, 1] for observations (N, O)."""
        x = np.clip((np.asarray(observation, np.float32) - self.mean) * self.scale, -self.clip, self.clip)
        for weight, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            x = np.maximum(x @ weight + bias, np.float32(0.0))
        return np.tanh(x @ self.weights[-1] + self.biases[-1])


def _frozen(values: ArrayLike) -> Array:
    array = np.array(values, dtype=np.float32)
    array.setflags(write=False)
    return array


@dataclass(frozen=True)
class Description(Table, unknown="keep"):
    """Purpose and provenance of a policy.

    Attributes:
        observation: the parts of an observation in their order, each with ``name``, ``size``, and what is known of it.
        ranges_sha256: of the ranges it was trained over.
        seed: of the training run.
        steps: environment steps of the training run.
        wall_time_s: of the training run [s].
        environment: further arguments of the environment it was trained in.
        versions: of the packages that made it.
        created: date and time.
        start: name of the policy that the run went on from; "": none.
    """

    task: Annotated[Task, Word(options=Task)]
    policy: Annotated[PolicyKind, Word(options=PolicyKind)]
    observation: tuple[dict[str, Any], ...]
    actions: Annotated[int, Key(f"1 to {_MOST - 1}", 1, _MOST - 1)]
    ranges_sha256: str
    seed: int
    steps: int
    wall_time_s: float
    backend: str
    environment: dict[str, Any] = field(default_factory=dict[str, Any])
    versions: dict[str, str] = field(default_factory=dict[str, str])
    created: str = ""
    start: str = ""

    @property
    def size(self) -> int:
        """Length of an observation."""
        return sum(part["size"] for part in self.observation)

    def as_table(self) -> dict[str, Any]:
        """Return plain values, with the format's name."""
        table = {**asdict(self), "task": str(self.task), "policy": str(self.policy)}
        return {"format": FORMAT, **table, "observation": [dict(part) for part in self.observation]}

    def violations(self) -> Iterator[Violation]:
        """Yield parts of an observation that are none, and values that are not plain."""
        for part in self.observation:
            size, ago = part.get("size"), part.get("steps_ago", 0)
            if type(size) is not int or not 0 < size < _MOST:
                yield "observation", f"a size of 1 to {_MOST - 1}", size
            elif not isinstance(part.get("name"), str) or type(ago) is not int or not 0 <= ago <= LONGEST_AGO:
                yield "observation", "a name, and steps_ago from 0 on", str(part)[:80]
        if not _is_plain(self.environment):
            yield "environment", "texts and finite numbers", str(self.environment)[:40]


def _is_plain(value: Any) -> bool:
    """Return whether a value is a text or a finite number, or a dictionary of these."""
    if isinstance(value, dict):
        return all(_is_plain(inner) for inner in cast("dict[str, Any]", value).values())
    return isinstance(value, str) or (isinstance(value, int | float) and math.isfinite(value))


class Policy:
    """A policy that is ready to act."""

    def __init__(self, network: Network, description: Description, file: str) -> None:
        self.network, self.description, self.file = network, description, file

    def __call__(self, observation: ArrayLike) -> NDArray[np.float32]:
        """Return the actions in [-1, 1], shape (A,) or (N, A).

        Args:
            observation: shape (O,) or (N, O), not normalised.

        Raises:
            WorkError: the observation is not finite, or too large for the network.
        """
        with np.errstate(over="ignore", invalid="ignore"):
            actions = self.network(np.atleast_2d(np.asarray(observation, dtype=np.float32)))
        if not np.isfinite(actions).all():
            raise WorkError(f"{self.file}: expected actions within [-1, 1]; got some that are no numbers")
        return actions[0] if np.ndim(observation) == 1 else actions


def read_policy(path: str | Path) -> Policy:
    """Read a policy file.

    Raises:
        InputError: it cannot be read, is no policy of skincal's, or is inconsistent.
    """
    from skincal.train.onnx_file import parse_policy

    path = Path(path)
    try:
        network, description = parse_policy(read_bytes(path, LARGEST_BYTES))
    except OSError as error:
        raise _refused(path, reason(error)) from error
    except UnreadableError as error:
        raise _refused(path, error.got) from error
    told = description.size, description.actions
    if (network.observations, network.actions) != told:
        made = f"{network.observations} values to {network.actions} actions"
        raise _refused(path, f"a network from {made}, described as one from {told[0]} to {told[1]}")
    return Policy(network, description, str(path))


def _refused(path: Path, got: str) -> InputError:
    return input_error(str(path), "a policy written by `skincal train` (.onnx)", got)


FOLDER = Path(__file__).parents[1] / "policies"


def bundled_policies() -> dict[str, Path]:
    """Return the file of every policy that comes with skincal, by name."""
    return _bundled(".onnx")


def policy_path(name: str | Path) -> Path:
    """Return the file of a policy: one that exists, or that of a policy that comes with skincal.

    Raises:
        InputError: there is neither.
    """
    return _path(name, ".onnx", "a policy")


def estimator_path(name: str | Path) -> Path:
    """Return the file of an estimator, as :func:`policy_path` does."""
    return _path(name, ".npz", "an estimator")


def _bundled(suffix: str) -> dict[str, Path]:
    return {path.stem: path for path in sorted(FOLDER.glob(f"*{suffix}"))}


def _path(name: str | Path, suffix: str, what: str) -> Path:
    path, known = Path(name), _bundled(suffix)
    if not path.exists() and str(name) not in known:
        choices = f", or one of {', '.join(known)}" if known else ""
        raise input_error(str(name), f"{what} file{choices}", "no such file")
    return path if path.exists() else known[str(name)]
