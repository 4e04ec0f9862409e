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
"""Speed at which letters are drawn: half the speed of the evaluation circle [m/s]."""
# One stroke per letter, since a marble cannot be lifted. Each pair of digits is a corner (x, y) in eighths of the
# letter's height, from the lower left; a letter is at most 7/8 wide.
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
    """Return the targets of a run at 10 Hz: positions of the marble (T, 2), or the bolt's displacement (T, 1) [m].

    Args:
        task: the task.
        trajectory: trajectory of the marble: ``circle``, ``still``, or a CSV file.
        write: letters that the marble draws instead.
        frequency_hz: frequency of the bolt's sine [Hz].
        duration_s: duration of the run [s]; None: that of the letters, or the task's default.

    Raises:
        InputError: letters were given for the bolt, the text has no letters, or the trajectory cannot be read.
    """
    if task is Task.bolt:
        if write is not None:
            raise input_error("--write", "the task marble", "bolt")
        return sine(round((duration_s or DURATION_S[task]) * POLICY_HZ) + 1, frequency_hz)
    if write is not None:
        path = letters(write)
        return path if duration_s is None else marble_targets(path, duration_s)
    path = trajectory if trajectory in FIXED else read_targets(Path(trajectory))
    return marble_targets(path, duration_s or DURATION_S[task])


def marble_targets(trajectory: str | ArrayLike, duration_s: float) -> FloatArray:
    """Return targets of the marble (T + 1, 2) at 10 Hz [m].

    Args:
        trajectory: ``circle``, ``still``, or targets (N, 2) [m], of which the last one is held.
        duration_s: duration of the run [s].

    Raises:
        InputError: the trajectory is unknown.
    """
    steps = max(1, round(duration_s * POLICY_HZ)) + 1
    if isinstance(trajectory, str) and trajectory not in FIXED:
        expected = f"one of {', '.join(FIXED)}, or a file"
        raise input_error("--trajectory", expected, f'"{trajectory}"')
    return planned(trajectory, steps)


def letters(
    text: str, size_m: float = 2 * CIRCLE_RADIUS_M, speed_m_per_s: float = WRITING_M_PER_S
) -> FloatArray:
    """Return targets (N, 2) at 10 Hz that write a text, each letter centred on the sensor [m].

    A letter is one stroke; from its end the marble moves straight to the start of the next.

    Args:
        text: the text; only letters A to Z are drawn.
        size_m: height of a letter [m].
        speed_m_per_s: speed of the marble [m/s].

    Raises:
        InputError: the text has no letter.
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
    arc = as_floats(np.concatenate([[0.0], np.cumsum(lengths)]))
    count = int(np.ceil(arc[-1] / speed_m_per_s * POLICY_HZ)) + 1
    at = as_floats(np.linspace(0.0, float(arc[-1]), count))
    return np.stack([np.interp(at, arc, corners_m[:, axis]) for axis in (0, 1)], axis=1)
