"""Shifts of the level at rest after a press: a sensor that tares itself while it is touched."""

from __future__ import annotations

import numpy as np

from skincal.dataset import IDLE, Dataset
from skincal.dataset.rest import ACTIVE_COUNTS
from skincal.errors import Problem
from skincal.model.arrays import FloatArray

AROUND = 3
"""Number of pauses on each side whose median is compared: a slow recovery of the skin is over in the next but one."""

SIGMAS = 8.0
"""A shift exceeds this many standard errors of the levels, and the threshold of an active taxel: noise alone
does not reach it in a hundred presses on a hundred taxels."""

FIX = (
    "If the sensor or its driver tares automatically, allow that only without contact; taxels that are tared under "
    "load read too low from then on."
)


def rest_shifts(dataset: Dataset) -> tuple[Problem, ...]:
    """Return the presses after which taxels rest at another level than before, permanently.

    Args:
        dataset: dataset with frames in the pauses between presses.
    """
    numbers, levels, errors = _pauses(dataset)
    found: list[Problem] = []
    for k in range(1, len(levels)):
        before = _median(levels[max(k - AROUND, 0) : k])
        after = _median(levels[k : k + AROUND])
        step, shift = np.abs(levels[k] - levels[k - 1]), np.abs(after - before)
        least = np.maximum(ACTIVE_COUNTS, SIGMAS * np.hypot(errors[k], errors[k - 1]))
        shifted = np.flatnonzero((shift > least) & (step > 0.5 * shift))
        if len(shifted):
            worst = int(shifted[np.argmax(shift[shifted])])
            name = dataset.meta.sensor.taxel_columns()[worst]
            more = f" ({len(shifted)} taxels in all)" if len(shifted) > 1 else ""
            got = f"{name} at {before[worst]:.3g} counts before and {after[worst]:.3g} after{more}"
            found.append(
                Problem(f"press {numbers[k - 1]}", "the same level at rest before and after it", got, FIX)
            )
    return tuple(found)


def _median(levels: FloatArray) -> FloatArray:
    """Return the median over pauses (J,); NaN for a taxel that is silent in one of them."""
    return np.median(levels, axis=0)


def _pauses(dataset: Dataset) -> tuple[list[int], FloatArray, FloatArray]:
    """Return the presses between pauses, and the level at rest of each pause with its standard error, (pauses, J)."""
    frames = dataset.frames
    assert frames is not None
    idle = frames.phase == IDLE
    starts = np.flatnonzero(np.diff(idle, prepend=~idle[:1]))
    numbers: list[int] = []
    levels: list[FloatArray] = []
    errors: list[FloatArray] = []
    pressed = -1
    for begin, end in zip(starts, [*starts[1:], len(idle)], strict=True):
        counts = frames.counts[begin:end]
        if not idle[begin]:
            pressed = int(frames.press[begin])
        elif end - begin > 1:
            if levels:
                numbers.append(pressed)
            levels.append(np.mean(counts, axis=0))
            # Whole counts: a constant level is known to a part of a step.
            errors.append(np.maximum(counts.std(axis=0, ddof=1), 0.3) / np.sqrt(end - begin))
    shape = (len(levels), frames.counts.shape[1])
    return numbers, np.reshape(levels, shape), np.reshape(errors, shape)
