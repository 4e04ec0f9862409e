"""A training run's state on disk: whole or not at all, and nothing in it is code."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from pickle import UnpicklingError
from typing import Any, Final
from zipfile import BadZipFile

import numpy as np

from skincal.errors import InputError, Problem
from skincal.files import check_input, open_input, whole_folder
from skincal.train.learner import Learner

STATE: Final = "state.json"
ARRAYS: Final = "arrays.npz"

# torch reads with a pickle that builds nothing but tensors, and has its own way to say that it found something else.
_DAMAGE = (OSError, KeyError, ValueError, TypeError, RuntimeError, BadZipFile, UnpicklingError)


@dataclass(frozen=True)
class Progress:
    """How far a run has come.

    Attributes:
        rounds: finished.
        steps: environment steps.
        wall_s: time it took, interruptions left out [s].
    """

    rounds: int = 0
    steps: int = 0
    wall_s: float = 0.0


def save_checkpoint(learner: Learner, progress: Progress, folder: Path) -> None:
    """Writes everything that a run needs to go on as if it had never stopped; the one before is replaced."""
    with whole_folder(folder, force=True, marker=STATE) as temporary:
        learner.save_weights(temporary / learner.weights_file)
        np.savez(temporary / ARRAYS, **learner.arrays())  # type: ignore[arg-type]
        state = {"progress": asdict(progress), "random": learner.random_state()}
        (temporary / STATE).write_text(json.dumps(state), encoding="utf-8")


def load_checkpoint(learner: Learner, folder: Path) -> Progress:
    """Takes a run up where its last checkpoint left it.

    Raises:
        InputError: the checkpoint is damaged, or of another task or backend.
    """
    try:
        with open_input(folder / STATE, folder) as file:
            state: dict[str, Any] = json.loads(file.read())
        learner.load_weights(check_input(folder / learner.weights_file, folder))
        with open_input(folder / ARRAYS, folder) as file, np.load(file, allow_pickle=False) as arrays:
            learner.restore(dict(arrays))
        learner.restore_random(state["random"])
        return Progress(**state["progress"])
    except _DAMAGE as error:
        got = " ".join(f"one with a fault ({error}".split())[:100] + ")"
        fix = f"Begin anew with another --out, or remove {folder.parent}."
        raise InputError([Problem(str(folder), "a whole checkpoint of this run", got, fix)]) from error
