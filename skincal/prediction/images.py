"""Images of presses and frames by a skin with effects: frames in the order of time, presses from their holds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from skincal.dataset import HOLD, Dataset
from skincal.effects import EffectSkin, Samples
from skincal.effects.effect import State
from skincal.model.arrays import FloatArray
from skincal.prediction.session_samples import (
    Floats,
    Ints,
    frame_samples,
    pose_names,
    press_order,
    standard_presses,
)
from skincal.prediction.touches import CHUNK, CalibratedSkin, Touches, frame_presses, touching

Progress = Callable[[int, int], None]
Readout = Callable[[FloatArray], Floats]


def images_with_effects(
    on: CalibratedSkin,
    dataset: Dataset,
    slack_m: Floats | None,
    readout: Readout | None = None,
    progress: Progress | None = None,
    ends: tuple[EffectSkin, ...] = (),
) -> list[tuple[Floats, Floats | None]]:
    """Return the images of a dataset by a skin with effects.

    Frames are simulated in sequence, so that effects with memory carry their state. A press is the mean over the frames
    of its hold. A press without frames is simulated as a standard press, independent of the others.

    Args:
        on: the skin.
        dataset: the presses.
        slack_m: (P, 2) shift of the presses across and along [m]; None: no shift.
        readout: function that clips values (N, J) to the converter's range; default: no clipping.
        progress: callback with the number of finished samples and of all samples.
        ends: skins for the stages after the contact, each with its own images; default: the skin itself.

    Returns:
        For each end, values of the presses (P, J) [counts], NaN at unknown positions, and of the frames (M, J).
    """
    ends, poses, count = ends or (on.full,), pose_names(dataset), len(dataset.presses)
    presses = [np.full((count, on.skin.patch.layout.taxels), np.nan) for _ in ends]
    frames: list[Floats | None] = [None for _ in ends]
    held = np.zeros(count, dtype=np.bool_)
    if dataset.frames is not None:
        touches, owner = Touches.of_frames(on, dataset, slack_m), frame_presses(dataset)
        own = np.flatnonzero(touching(dataset) & (dataset.frames.phase == HOLD))
        samples = frame_samples(touches, dataset, poses)
        for k, values in enumerate(_values(on.full, ends, samples, progress)):
            clipped = readout(values) if readout else values
            frames[k] = clipped
            presses[k], held = _means(clipped[own], owner[own], count)
    others = press_order(dataset)
    others = others[~held[others]]
    if len(others):
        touches = Touches.of_presses(on, dataset, slack_m)
        some = touches.select(others)
        played = standard_presses(some.contacts(), some.indenters(), dataset, others, poses)
        samples = played.samples
        if dataset.frames is not None and len(dataset.frames) and samples.time_s is not None:
            # Drifts count from the beginning of the session.
            samples = replace(samples, start_s=min(float(dataset.frames.time_s[0]), samples.start_s))
        each = len(samples) // len(others)
        for k, values in enumerate(_values(on.full, ends, samples, progress, each)):
            presses[k][others] = played.means(
                np.asarray(readout(values) if readout else values, dtype=np.float64)
            )
    return list(zip(presses, frames, strict=True))


def _values(
    skin: EffectSkin, ends: tuple[EffectSkin, ...], samples: Samples, progress: Progress | None, each: int = 0
) -> list[FloatArray]:
    """Return the values (K, J) of a session for each end, computed in chunks.

    The state of memory is reset after every ``each`` samples; 0: never.
    """
    out = [np.empty((len(samples), skin.skin.patch.layout.taxels)) for _ in ends]
    each = each if any(end.has_memory for end in ends) else 0
    step = each * max(1, CHUNK // each) if each else CHUNK
    states: list[dict[int, State]] = [{} for _ in ends]
    for first in range(0, len(samples), step):
        contacted = skin.contact(samples[first : first + step])
        loads, felt = skin.loads(contacted), contacted.samples
        for begin in range(0, len(loads), each or step):
            part = slice(begin, begin + (each or step))
            for values, end, state in zip(out, ends, states, strict=True):
                if each:
                    state.clear()
                values[first : first + step][part] = end.after(loads[part], felt[part], state)
        if progress is not None:
            progress(min(first + step, len(samples)), len(samples))
    return out


def _means(values: Floats, owner: Ints, count: int) -> tuple[Floats, NDArray[np.bool_]]:
    """Return the means (P, J) of the known values (N, J) of each press, and which presses have any."""
    known = np.isfinite(values).all(axis=1)
    total = np.zeros((count, values.shape[1]))
    np.add.at(total, owner[known], values[known])
    number = np.bincount(owner[known], minlength=count)
    return total / np.where(number > 0, number, np.nan)[:, None], number > 0
