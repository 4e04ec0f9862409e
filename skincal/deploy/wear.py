"""Wear: one overall factor for lost sensitivity, from rolling an object on the hand and in simulation.

The skin's sensitivity while a policy rolls an object (counts per newton, fractions of the taxels, and growth with
force) is compared with that of simulated hands drawn from the calibration. These roll the same object with the same
policy through the same driver interface. Under the null hypothesis of no wear, the hand is exchangeable with them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from skincal.calibration import Calibration, check_same_sensor
from skincal.dataset import HOLD, read_dataset
from skincal.deploy.policy_run import deploy
from skincal.deploy.record import SESSION, RunFile
from skincal.deploy.targets import targets_of
from skincal.envs.pinch import read_pinch
from skincal.envs.reference_hand import ReferenceHand
from skincal.errors import WorkError, input_error
from skincal.model.arrays import FloatArray
from skincal.ranges import from_calibration
from skincal.train.policy_file import policy_path, read_policy
from skincal.train.settings import part_seed

ALARM = 0.1
"""p-value at or below which one common factor is rejected."""
_LEAST_N = 0.5
"""Smallest force of a state that is used [N]."""
_FEWEST = 20
"""Smallest number of states."""


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """Sensitivity of a skin while an object was rolled on it.

    Attributes:
        counts_per_n: sum of all taxels' counts above rest over the sum of the forces [counts/N].
        shares: (J,) fraction of each taxel in the sum of counts.
        growth: counts per newton at forces above the median over those below it.
    """

    counts_per_n: float
    shares: FloatArray
    growth: float


@dataclass(frozen=True)
class Wear:
    """Estimate of the remaining sensitivity.

    Attributes:
        factor: factor of the scale; 1: no loss.
        interval: confidence interval of the factor.
        level: confidence level of the interval: about 95 %, or with few hands (n - 1) / (n + 1).
        hands: number n of simulated hands that held the object.
        p_shares: p-value of the taxels' fractions under the null hypothesis of one common factor.
        p_growth: p-value of the growth with force.
        worst_taxel: taxel whose fraction deviates most.
    """

    factor: float
    interval: tuple[float, float]
    level: float
    hands: int
    p_shares: float
    p_growth: float
    worst_taxel: int

    @property
    def is_one_factor_enough(self) -> bool:
        """True if the data do not reject one common factor (two tests, Bonferroni corrected)."""
        return 2 * min(self.p_shares, self.p_growth) > ALARM


def measure_sensitivity(images_counts: FloatArray, force_n: FloatArray) -> Sensitivity:
    """Return the sensitivity of the skin in a run.

    Args:
        images_counts: (T, J) images above rest [counts]; negative values and NaN count as 0.
        force_n: (T,) normal forces [N].

    Raises:
        WorkError: there are too few images under force.
    """
    counts = np.maximum(np.nan_to_num(images_counts), 0.0)
    pressed = np.nan_to_num(force_n) >= _LEAST_N
    if pressed.sum() < _FEWEST or not counts[pressed].sum() > 0:
        raise WorkError(
            f"rolling: expected {_FEWEST} images or more under {_LEAST_N:g} N or more; got {int(pressed.sum())}. "
            "Roll for longer, or check the force in run.png."
        )
    counts, force = counts[pressed], force_n[pressed]
    total = counts.sum(axis=1)
    hard = force > np.median(force)
    growth = (total[hard].sum() / force[hard].sum()) / max(total[~hard].sum() / force[~hard].sum(), 1e-9)
    shares = counts.sum(axis=0) / total.sum()
    return Sensitivity(float(total.sum() / force.sum()), shares, float(growth))


def estimate_wear(hand: Sensitivity, simulated: Sequence[Sensitivity]) -> Wear:
    """Estimate the wear of a hand by comparison with n simulated ones.

    Raises:
        WorkError: there are fewer than three simulated hands.
    """
    count = len(simulated)
    if count < 3:
        raise WorkError(
            f"rescale: expected at least three simulated hands that hold the object; got {count}. Use another policy."
        )
    ratios = np.sort(np.array([hand.counts_per_n / one.counts_per_n for one in simulated]))
    # Without wear, all ranks of the hand are equally likely: order statistics of the ratios bound the factor.
    rank = max(1, int(0.025 * (count + 1)))
    shares = np.array([one.shares for one in (*simulated, hand)])
    growths = np.log(np.maximum([one.growth for one in (*simulated, hand)], 1e-9))[:, None]
    off = np.abs(shares[-1] - shares[:-1].mean(axis=0))
    return Wear(
        factor=float(np.median(ratios)),
        interval=(float(ratios[rank - 1]), float(ratios[count - rank])),
        level=1 - 2 * rank / (count + 1),
        hands=count,
        p_shares=_rank_p(shares),
        p_growth=_rank_p(growths),
        worst_taxel=int(off.argmax()),
    )


def rescale_calibration(calibration: Calibration, factor: float) -> Calibration:
    """Return a calibration whose scale, its interval and its draws are multiplied by a factor of remaining sensitivity.

    The factor is relative to the draws of the calibration, so that its uncertainty already contains that of the scale:
    the interval is multiplied, not widened.
    """
    model, draws = calibration.model, calibration.draws
    each = model.scale_per_taxel_per_n
    scaled = replace(
        model,
        scale_per_n=factor * model.scale_per_n,
        scale_per_taxel_per_n=None if each is None else tuple(factor * s for s in each),
    )
    low, high = calibration.intervals["scale_per_n"]
    intervals = {**calibration.intervals, "scale_per_n": (low * factor, high * factor)}
    if draws is not None and "scale_per_n" in draws:
        draws = {**draws, "scale_per_n": np.asarray(draws["scale_per_n"]) * factor}
    return replace(calibration, model=scaled, intervals=intervals, draws=draws, grid=None)


def _rank_p(rows: FloatArray) -> float:
    """Return the rank p-value of the last row of (N, D): the fraction of rows that are as far from the others' mean."""
    others = (rows.sum(axis=0) - rows) / (len(rows) - 1)
    far: list[float] = np.linalg.norm(rows - others, axis=1).tolist()
    return sum(one >= far[-1] for one in far) / len(far)


def recorded_sensitivity(folder: Path, run: RunFile, calibration: Calibration) -> Sensitivity:
    """Return the sensitivity of the skin in the recorded run of a folder.

    Raises:
        InputError: the session is of another sensor than the calibration, or has no frames, or frames with another
            number of taxels.
        WorkError: the run has too few images under force.
    """
    session = read_dataset(folder / SESSION)
    check_same_sensor(calibration, session)
    frames = session.frames
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
