"""A training run's state on disk: whole or not at all, and nothing in it is code."""

from __future__ import annotations

import json
import shutil
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np

from skincal.bounded import parse_json, read_arrays, read_text
from skincal.dataset.findings import Findings
from skincal.dataset.schema import Table, read_table
from skincal.errors import input_error, text_of
from skincal.files import check_input, whole_folder
from skincal.train.learner import Learner
from skincal.train.settings import Within

STATE: Final = "state.json"
ARRAYS: Final = "arrays.npz"


@dataclass(frozen=True)
class Progress(Table, unknown="keep"):
    """Progress of a run.

    Attributes:
        rounds: finished.
        wall_s: time it took, interruptions left out [s].
    """

    rounds: Annotated[int, Within(0, 2**53 - 1)]
    steps: Annotated[int, Within(0, 2**53 - 1)]
    wall_s: Annotated[float, Within(0, np.inf)]


BEGINNING: Final = Progress(0, 0, 0.0)


def save_checkpoint(learner: Learner, progress: Progress, folder: Path) -> None:
    """Write everything that a run needs to go on as if it had never stopped; the one before is replaced."""
    with whole_folder(folder, force=True, marker=STATE) as temporary:
        learner.save_weights(temporary / learner.weights_file)
        np.savez(temporary / ARRAYS, **learner.arrays())  # type: ignore[arg-type]
        state = {"progress": asdict(progress), "random": learner.random_state()}
        (temporary / STATE).write_text(json.dumps(state), encoding="utf-8")


def fork_checkpoint(source: Path, folder: Path) -> None:
    """Write the last checkpoint of a run as one at step 0: networks, memory and normalisation stay.

    Raises:
        InputError: there is none, or it is damaged.
    """
    try:
        state: dict[str, Any] = parse_json(read_text(source / STATE, within=source), bits=128)
        arrays = read_arrays(source / ARRAYS, source)
        arrays["counters"] = np.zeros_like(arrays["counters"])
        (weights,) = source.glob("weights.*")
        check_input(weights, source)
    except Exception as error:
        got = f"none, or one with a fault ({text_of(error, 100)})"
        raise input_error(str(source), "a whole checkpoint of a run", got) from error
    folder.mkdir()
    shutil.copyfile(weights, folder / weights.name)
    np.savez(folder / ARRAYS, **arrays)  # type: ignore[arg-type]
    state["progress"] = asdict(BEGINNING)
    (folder / STATE).write_text(json.dumps(state), encoding="utf-8")


def load_checkpoint(learner: Learner, folder: Path) -> Progress:
    """Take a run up where its last checkpoint left it.

    Raises:
        InputError: the checkpoint is damaged, or of another task or backend.
    """
    try:
        state: dict[str, Any] = parse_json(read_text(folder / STATE, within=folder), bits=128)
        learner.load_weights(check_input(folder / learner.weights_file, folder))
        learner.restore(read_arrays(folder / ARRAYS, folder))
        learner.restore_random(state["random"])
        findings = Findings()
        progress = read_table(Progress, state["progress"], findings, STATE)
        findings.raise_errors()
        return progress
    except Exception as error:  # torch, msgpack and the learners have no common class for what they raise
        got = f"one with a fault ({text_of(error, 100)})"
        fix = f"Begin anew with another --out, or remove {folder.parent}."
        raise input_error(str(folder), "a whole checkpoint of this run", got, fix) from error
