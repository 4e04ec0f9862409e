"""Rounds of learning: the learner's callback that observes them, and the learning curve as a table on disk."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import astuple, dataclass, fields
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.callbacks import BaseCallback

from skincal.bounded import UnreadableError, parse_csv, read_text
from skincal.errors import input_error
from skincal.files import reason, whole_file


@dataclass(frozen=True)
class Round:
    """Figures of one round: the steps gathered in it, and the learning phase before it.

    Attributes:
        steps: environment steps since the beginning of the run.
        reward: mean of a step.
        error_m: mean distance between object and target [m].
        episode_steps: mean length of the episodes that ended in the round; NaN where none did.
        drops: share of those that ended because the object was lost; NaN where none did.
        actor_loss: of the learning phase before.
        critic_loss: of the learning phase before.
        gather_s: time spent on steps [s].
        learn_s: time spent on the learning phase before [s].
    """

    steps: int
    reward: float
    error_m: float
    episode_steps: float
    drops: float
    entropy_coefficient: float
    actor_loss: float
    critic_loss: float
    gather_s: float
    learn_s: float


COLUMNS = tuple(field.name for field in fields(Round))


class RoundWatch(BaseCallback):
    """Callback of a learner that summarises every round."""

    def __init__(self) -> None:
        super().__init__()
        self.report: Callable[[Round], None] = lambda _: None
        self._length: Any = None
        self._ended: float | None = None
        self._learn_s = 0.0

    def _on_training_start(self) -> None:
        self._length = np.zeros(self.training_env.num_envs)

    def _on_training_end(self) -> None:
        self._end_learning()

    def _end_learning(self) -> None:
        if self._ended is not None:
            self._learn_s, self._ended = time.perf_counter() - self._ended, None

    def _on_rollout_start(self) -> None:
        self._end_learning()
        self._began = time.perf_counter()
        self._rewards: list[float] = []
        self._errors: list[float] = []
        self._lengths: list[float] = []
        self._drops: list[bool] = []

    def _on_step(self) -> bool:
        self._rewards.append(float(np.mean(np.asarray(self.locals["rewards"], dtype=np.float64))))
        self._length += 1
        for i, (done, info) in enumerate(zip(self.locals["dones"], self.locals["infos"], strict=True)):
            self._errors.append(info["error_m"])
            if done:
                self._lengths.append(self._length[i])
                self._drops.append(bool(info["drop"]))
                self._length[i] = 0
        return True

    def _on_rollout_end(self) -> None:
        now = time.perf_counter()
        figures = self.logger.name_to_value
        row = Round(
            steps=self.num_timesteps,
            reward=_mean(self._rewards),
            error_m=_mean(self._errors),
            episode_steps=_mean(self._lengths),
            drops=_mean(self._drops),
            entropy_coefficient=float(figures.get("train/ent_coef", np.nan)),
            actor_loss=_figure(figures, "train/actor_loss", "train/policy_gradient_loss"),
            critic_loss=_figure(figures, "train/critic_loss", "train/value_loss"),
            gather_s=now - self._began,
            learn_s=self._learn_s,
        )
        self._ended = now
        self.report(row)


def _figure(figures: dict[str, Any], *names: str) -> float:
    """Return the first figure that exists: algorithms use different names."""
    return next((float(figures[name]) for name in names if name in figures), float("nan"))


def _mean(values: list[Any]) -> float:
    """Return the mean of what is finite (an object that is lost has no distance); NaN of nothing."""
    array = np.array(values, dtype=np.float64)
    array = array[np.isfinite(array)]
    return float(array.mean()) if array.size else float("nan")


class Curve(AbstractContextManager["Curve"]):
    """Appends rows to a CSV file; each is on disk as soon as it is known.

    Args:
        steps: rows beyond so many environment steps are dropped: the run goes on from a checkpoint before them.
    """

    def __init__(self, path: Path, steps: int) -> None:
        rows = [row for row in _rows(path) if float(row[0]) <= steps]
        with whole_file(path, force=True) as temporary:
            temporary.write_text("".join(map(_line, [COLUMNS, *rows])), encoding="utf-8")
        self._file: IO[str] = path.open("a", encoding="utf-8", newline="")

    def __exit__(self, *_: object) -> None:
        """Close the file."""
        self._file.close()

    def add(self, row: Round) -> None:
        """Append a row."""
        values = astuple(row)
        self._file.write(_line([str(values[0]), *(f"{value:.6g}" for value in values[1:])]))
        self._file.flush()

    def sync(self) -> None:
        """Bring the rows to the disk."""
        os.fsync(self._file.fileno())


def read_curve(path: str | Path) -> dict[str, NDArray[np.float64]]:
    """Return the columns of a learning curve by name (see :class:`~skincal.train.curve.Round`).

    Raises:
        InputError: there is no such file, or it is something else.
    """
    path = Path(path)
    rows = _rows(path)
    if not rows:
        raise input_error(str(path), "the learning curve of a training run", "nothing")
    columns = np.array(rows, dtype=np.float64).T
    return dict(zip(COLUMNS, columns, strict=True))


def _rows(path: Path) -> list[list[str]]:
    """Return whole rows below the head; the last line of a killed run may be cut off."""
    try:
        head, *rows = parse_csv(read_text(path, within=path.parent)) or [[]]
        if tuple(head) != COLUMNS:
            raise UnreadableError(f"the columns {', '.join(COLUMNS)}", ", ".join(head)[:200])
    except FileNotFoundError:
        return []
    except OSError as error:
        raise input_error(str(path), "a learning curve", reason(error)) from None
    except UnreadableError as error:
        raise input_error(str(path), error.expected, error.got) from None
    whole = [row for row in rows if len(row) == len(COLUMNS) and all(map(_is_number, row))]
    if len(whole) < len(rows) - 1:
        raise input_error(str(path), f"{len(COLUMNS)} numbers in every row", "other rows")
    return whole


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _line(cells: Sequence[str]) -> str:
    return ",".join(cells) + "\n"
