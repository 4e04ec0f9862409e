"""A policy file, read and run: neither the learner nor a pickle is needed, and nothing in the file is code."""

from __future__ import annotations

import json
import os
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skincal.errors import InputError, Problem
from skincal.files import open_input, reason
from skincal.train.settings import PolicyKind, Task

if TYPE_CHECKING:
    from onnxruntime import InferenceSession

FORMAT: Final = "skincal-policy/1"
DESCRIPTION_KEY: Final = "skincal"
"""The name in the file's metadata under which the description stands, as JSON."""

INPUT: Final = "observation"
OUTPUT: Final = "action"
LARGEST_BYTES: Final = 50_000_000
"""A policy is half a megabyte; whatever is larger than this is none."""


@dataclass(frozen=True)
class Description:
    """What a policy is for, and where it comes from.

    Attributes:
        task: what it rolls.
        policy: what it sees.
        observation: the parts of an observation in their order, each with ``name``, ``size``, and what is known of it.
        actions: length of an action.
        ranges_sha256: of the ranges it was trained over.
        seed: of the training run.
        steps: environment steps of the training run.
        wall_time_s: of the training run [s].
        backend: who learned.
        environment: further arguments of the environment it was trained in.
        versions: of the packages that made it.
        created: date and time.
    """

    task: Task
    policy: PolicyKind
    observation: tuple[dict[str, Any], ...]
    actions: int
    ranges_sha256: str
    seed: int
    steps: int
    wall_time_s: float
    backend: str
    environment: dict[str, Any] = field(default_factory=dict[str, Any])
    versions: dict[str, str] = field(default_factory=dict[str, str])
    created: str = ""

    @property
    def size(self) -> int:
        """Length of an observation."""
        return sum(int(part["size"]) for part in self.observation)

    def as_table(self) -> dict[str, Any]:
        """Plain values, with the format's name."""
        table = {**asdict(self), "task": str(self.task), "policy": str(self.policy)}
        return {"format": FORMAT, **table, "observation": [dict(part) for part in self.observation]}

    @classmethod
    def from_table(cls, table: dict[str, Any]) -> Description:
        """Inverse of :meth:`as_table`; unknown names are left out.

        Raises:
            KeyError, TypeError, ValueError: something is missing or of a wrong kind.
        """
        if table["format"] != FORMAT:
            raise ValueError(f'the format "{table["format"]}"')
        known: dict[str, Any] = {part.name: table[part.name] for part in fields(cls)}
        known["observation"] = tuple(dict(part) for part in known["observation"])
        known |= {"task": Task(known["task"]), "policy": PolicyKind(known["policy"])}
        return cls(**known)


class Policy:
    """A policy that is ready to act.

    Attributes:
        description: what it is for.
        file: where it was read from.
    """

    def __init__(self, session: InferenceSession, description: Description, file: str) -> None:
        self._session, self.description, self.file = session, description, file

    def __call__(self, observation: ArrayLike) -> NDArray[np.float32]:
        """Acts.

        Args:
            observation: shape (O,) or (N, O), not normalised.

        Returns:
            Actions in [-1, 1], shape (A,) or (N, A).
        """
        batch = np.atleast_2d(np.asarray(observation, dtype=np.float32))
        (actions,) = self._session.run([OUTPUT], {INPUT: batch})
        found = np.asarray(actions, dtype=np.float32)
        return found[0] if np.ndim(observation) == 1 else found


def read_policy(path: str | Path) -> Policy:
    """Reads a policy file.

    Raises:
        InputError: it cannot be read, is no policy of skincal's, or does not hang together.
    """
    path = Path(path)
    content = _content(path)
    session = _session(path, content)
    description = _description(path, session)
    _check_shapes(path, session, description)
    return Policy(session, description, str(path))


def _content(path: Path) -> bytes:
    try:
        with open_input(path) as file:
            content = file.read(LARGEST_BYTES + 1)
    except OSError as error:
        raise _refused(path, reason(error)) from error
    if len(content) > LARGEST_BYTES:
        raise _refused(path, f"a file of more than {LARGEST_BYTES / 1e6:.0f} MB")
    return content


def _session(path: Path, content: bytes) -> InferenceSession:
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4
    # Weights may stand in other files beside an ONNX file; where these are looked for there is nothing.
    options.add_session_config_entry("session.model_external_initializers_file_folder_path", os.devnull)
    try:
        return onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # the library has no common class for what it raises
        reason = " ".join(str(error).split())[:200]
        raise _refused(path, f"something that is no ONNX model ({reason})") from error


def _description(path: Path, session: InferenceSession) -> Description:
    text = session.get_modelmeta().custom_metadata_map.get(DESCRIPTION_KEY)
    if text is None:
        raise _refused(path, "an ONNX model without a description")
    try:
        return Description.from_table(json.loads(text))
    except (KeyError, TypeError, ValueError) as error:
        raise _refused(path, f"a description with a fault: {error}") from error


def _check_shapes(path: Path, session: InferenceSession, description: Description) -> None:
    inputs = {part.name: part.shape[-1] for part in session.get_inputs() if part.shape}
    outputs = {part.name: part.shape[-1] for part in session.get_outputs() if part.shape}
    told = {INPUT: description.size}, {OUTPUT: description.actions}
    if (inputs, outputs) != told:
        raise _refused(
            path, f"a graph from {inputs} to {outputs}, described as one from {told[0]} to {told[1]}"
        )


def _refused(path: Path, got: str) -> InputError:
    return InputError([Problem(str(path), "a policy written by `skincal train` (.onnx)", got)])
