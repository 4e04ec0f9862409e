"""Sensitivity of the skin in a run on a hand, and in the same run on simulated hands drawn from a calibration."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from skincal.calibration import Calibration
from skincal.dataset import HOLD, read_dataset
from skincal.deploy.policy_run import deploy
from skincal.deploy.run_file import SESSION, RunFile
from skincal.deploy.targets import targets_of
from skincal.deploy.wear import Sensitivity, measure_sensitivity
from skincal.envs.pinch import read_pinch
from skincal.envs.reference_hand import ReferenceHand
from skincal.errors import WorkError, input_error
from skincal.ranges import from_calibration
from skincal.train.policy_file import policy_path, read_policy
from skincal.train.settings import part_seed


def recorded_sensitivity(folder: Path, run: RunFile) -> Sensitivity:
    """Return the sensitivity of the skin in the recorded run of a folder.

    Raises:
        InputError: the session has no frames, or frames with another number of taxels.
        WorkError: the run has too few images under force.
    """
    frames = read_dataset(folder / SESSION).frames
    if frames is None:
        raise input_error(str(folder / SESSION), "frames of the run", "none")
    acting = np.asarray(frames.phase) == HOLD
    images = np.asarray(frames.counts, dtype=np.float64)[acting]
    if images.shape[1] != len(run.rest_counts):
        raise input_error(str(folder), f"rest_counts of {images.shape[1]} taxels", len(run.rest_counts))
    return measure_sensitivity(images - np.array(run.rest_counts), np.asarray(frames.force_n)[acting])


def simulated_sensitivities(
    calibration: Calibration, run: RunFile, hands: int, seed: int, progress: Callable[[str, int, int], None]
) -> list[Sensitivity]:
    """Repeat a run on hands drawn from a calibration; return the sensitivity of those that hold the object.

    Args:
        calibration: calibration of the hand before wear.
        run: the run to repeat.
        hands: number of hands.
        seed: seed of the hands.
        progress: callback (stage, done, total).
    """
    ranges = from_calibration(calibration, joint=calibration.draws is not None)
    policy, pinch, options = read_policy(policy_path(run.policy)), read_pinch(None), run.asked
    targets = targets_of(
        run.task, options.trajectory, options.write, options.frequency_hz, options.duration_s
    )
    sensitivities: list[Sensitivity] = []
    for number in range(hands):
        progress("simulated hands", number, hands)
        hand = ReferenceHand(
            task=run.task.value,
            seed=part_seed(seed, number),
            ranges=ranges,
            orientation_deg=options.orientation_deg,
        )
        width, speed = hand.object_width_m, options.speed_rad_per_s
        try:
            done = deploy(
                policy, hand, pinch, targets[: run.steps + 1], object_width_m=width, speed_rad_per_s=speed
            )
        except WorkError:
            continue  # The guard stopped the hand: the run is not comparable.
        if done.lost_s is None:
            record, acting = done.record, done.record.is_acting
            sensitivities.append(measure_sensitivity(record.centroids_m[acting], record.grip_n[acting]))
    return sensitivities
