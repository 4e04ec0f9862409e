"""What the skin felt in a run on a hand, and in the same run on simulated hands that are drawn from a calibration."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from skincal.calibration import Calibration
from skincal.dataset import HOLD, read_dataset
from skincal.deploy.policy_run import deploy
from skincal.deploy.run_file import SESSION, RunFile
from skincal.deploy.targets import targets_of
from skincal.deploy.wear import Feel, feel
from skincal.envs.pinch import read_pinch
from skincal.envs.reference_hand import ReferenceHand
from skincal.errors import WorkError, input_error
from skincal.ranges import from_calibration
from skincal.train.policy_file import policy_path, read_policy
from skincal.train.settings import part_seed


def felt(folder: Path, run: RunFile) -> Feel:
    """Return what the skin felt in the run of a folder.

    Raises:
        InputError: the session has no frames, or of another number of taxels.
        WorkError: too little of it pressed on the skin.
    """
    frames = read_dataset(folder / SESSION).frames
    if frames is None:
        raise input_error(str(folder / SESSION), "frames of the run", "none")
    acting = np.asarray(frames.phase) == HOLD
    images = np.asarray(frames.counts, dtype=np.float64)[acting]
    if images.shape[1] != len(run.rest_counts):
        raise input_error(str(folder), f"rest_counts of {images.shape[1]} taxels", len(run.rest_counts))
    return feel(images - np.array(run.rest_counts), np.asarray(frames.force_n)[acting])


def felt_in_simulation(
    calibration: Calibration, run: RunFile, hands: int, seed: int, progress: Callable[[str, int, int], None]
) -> list[Feel]:
    """Return what the skins of hands drawn from the calibration feel in the same run, those that hold the object.

    Args:
        calibration: of the hand before it wore.
        run: what is repeated.
        hands: how many are drawn.
        seed: of the hands.
        progress: callback (stage, done, total).
    """
    ranges = from_calibration(calibration, joint=calibration.draws is not None)
    policy, pinch, asked = read_policy(policy_path(run.policy)), read_pinch(None), run.asked
    way = targets_of(run.task, asked.trajectory, asked.write, asked.frequency_hz, asked.duration_s)
    found: list[Feel] = []
    for number in range(hands):
        progress("simulated hands", number, hands)
        hand = ReferenceHand(
            task=run.task.value,
            seed=part_seed(seed, number),
            ranges=ranges,
            orientation_deg=asked.orientation_deg,
        )
        width, speed = hand.object_width_m, asked.speed_rad_per_s
        try:
            done = deploy(
                policy, hand, pinch, way[: run.steps + 1], object_width_m=width, speed_rad_per_s=speed
            )
        except WorkError:
            continue  # A hand that the guard stops has rolled nothing.
        if done.lost_s is None:
            record = done.record
            acting = np.array([phase == "acting" for phase in record.phases])
            found.append(feel(record.centroids_m[acting], record.grip_n[acting]))
    return found
