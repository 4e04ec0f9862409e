"""Target trajectories: published ones, polylines, and letters."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from skincal.envs.trajectories import CIRCLE_RADIUS_M, FIXED, POLICY_HZ, planned, read_targets, sine
from skincal.errors import input_error
from skincal.model.arrays import FloatArray, as_floats
from skincal.tasks import DURATION_S, Task

WRITING_M_PER_S = 2.5e-3
"""Speed at which letters are drawn: half of that of the evaluated circle [m/s]."""
# One stroke a letter, as a marble cannot be lifted: corners in a box 0.7 wide and 1 high, from the left below.
_STROKES = {
    "A": "00 38 70 52 22", "B": "00 08 58 77 75 54 04 54 73 71 50 00", "C": "77 68 28 06 02 20 60 71",
    "D": "00 08 48 76 72 40 00", "E": "70 00 04 54 04 08 78", "F": "00 04 54 04 08 78",
    "G": "77 68 28 06 02 20 60 72 74 44", "H": "00 08 04 74 78 70", "I": "30 38", "J": "02 20 40 62 68",
    "K": "00 08 04 78 04 70", "L": "08 00 70", "M": "00 08 34 78 70", "N": "00 08 70 78",
    "O": "40 20 02 06 28 58 76 72 40", "P": "00 08 58 77 75 54 04", "Q": "40 20 02 06 28 58 76 72 40 52 70",
    "R": "00 08 58 77 75 54 04 34 70", "S": "01 20 50 71 73 54 24 05 07 28 58 77", "T": "30 38 08 78",
    "U": "08 02 20 50 72 78", "V": "08 30 78", "W": "08 20 35 50 78", "X": "00 78 34 08 70",
    "Y": "30 34 08 34 78", "Z": "08 78 00 70",
}  # fmt: skip


def targets_of(
    task: Task, trajectory: str, write: str | None, frequency_hz: float, duration_s: float | None
) -> FloatArray:
    """Return the targets of a run at 10 Hz: of the marble (T, 2), or the bolt's way along its normal (T, 1) [m].

    Args:
        task: what is rolled.
        trajectory: of the marble: ``circle``, ``still``, or a CSV file.
        write: letters that the marble draws instead.
        frequency_hz: of the bolt's sine.
        duration_s: length of the run; None: that of the letters, or as usual for the task.

    Raises:
        InputError: letters for the bolt, a text without letters, a trajectory that cannot be read.
    """
    if task is Task.bolt:
        if write is not None:
            raise input_error("--write", "the task marble", "bolt")
        return sine(round((duration_s or DURATION_S[task]) * POLICY_HZ) + 1, frequency_hz)
    if write is not None:
        way = letters(write)
        return way if duration_s is None else marble_targets(way, duration_s)
    way = trajectory if trajectory in FIXED else read_targets(Path(trajectory))
    return marble_targets(way, duration_s or DURATION_S[task])


def marble_targets(trajectory: str | ArrayLike, duration_s: float) -> FloatArray:
    """Return targets of the marble (T + 1, 2) at 10 Hz [m].

    Args:
        trajectory: ``circle``, ``still``, or targets (N, 2) whose last one stays.
        duration_s: length of the run.

    Raises:
        InputError: no such trajectory.
    """
    steps = max(1, round(duration_s * POLICY_HZ)) + 1
    if isinstance(trajectory, str) and trajectory not in FIXED:
        expected = f"one of {', '.join(FIXED)}, or a file"
        raise input_error("--trajectory", expected, f'"{trajectory}"')
    return planned(trajectory, steps)


def letters(
    text: str, size_m: float = 2 * CIRCLE_RADIUS_M, speed_m_per_s: float = WRITING_M_PER_S
) -> FloatArray:
    """Return a way (N, 2) at 10 Hz that writes a text, each letter over the middle of the sensor [m].

    A letter is one stroke; from its end the marble goes straight to the beginning of the next.

    Raises:
        InputError: no letter in the text.
    """
    corners = [np.zeros((1, 2))]
    for letter in text.upper():
        if letter in _STROKES:
            points = np.array([[int(pair[0]), int(pair[1])] for pair in _STROKES[letter].split()])
            corners.append((points / 8.0 - [0.4375, 0.5]) * size_m)
    if len(corners) == 1:
        raise input_error("--write", "a text with letters A to Z", f'"{text}"')
    return polyline(np.concatenate(corners), speed_m_per_s)


def polyline(corners_m: FloatArray, speed_m_per_s: float) -> FloatArray:
    """Return points (N, 2) at 10 Hz along straight lines between corners (K, 2), at constant speed [m]."""
    lengths = np.linalg.norm(np.diff(corners_m, axis=0), axis=1)
    way = as_floats(np.concatenate([[0.0], np.cumsum(lengths)]))
    count = int(np.ceil(way[-1] / speed_m_per_s * POLICY_HZ)) + 1
    at = as_floats(np.linspace(0.0, float(way[-1]), count))
    return np.stack([np.interp(at, way, corners_m[:, axis]) for axis in (0, 1)], axis=1)
