"""Wear: one overall factor for lost sensitivity, from rolling an object on the hand and in simulation.

What the skin answers while a policy rolls an object (counts for each newton, the taxels' shares of it, and how it grows
with force) is compared with what it answers on simulated hands drawn from the calibration, which roll the same object
with the same policy through the same driver interface. Were nothing worn, the hand would be one more of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from skincal.calibration import Calibration
from skincal.errors import WorkError
from skincal.model.arrays import FloatArray

HANDS = 19
"""Simulated hands: with 19 a rank among them tells something at 10 %, one in twenty at each end."""
ALARM = 0.1
"""One factor is told not to be enough at this p-value or below."""
_LEAST_N = 0.5
"""States with less force tell nothing of the sensitivity [N]."""
_FEWEST = 20


@dataclass(frozen=True, eq=False)
class Feel:
    """Tactile images recorded while an object was rolled on a skin.

    Attributes:
        counts_per_n: all taxels' counts above rest over the force.
        shares: (J,) of each taxel.
        growth: sensitivity at forces above the median over that below it.
    """

    counts_per_n: float
    shares: FloatArray
    growth: float


@dataclass(frozen=True)
class Wear:
    """Estimate of the remaining sensitivity.

    Attributes:
        factor: of the scale; 1 is none lost.
        interval: of it.
        level: of the interval: 95 %, or what so few hands allow, (n - 1) / (n + 1).
        hands: simulated hands that held the object.
        p_shares: chance of shares of the taxels as unlike the simulated ones', were one factor enough.
        p_growth: the same of the growth with force.
        worst_taxel: whose share is off by most.
    """

    factor: float
    interval: tuple[float, float]
    level: float
    hands: int
    p_shares: float
    p_growth: float
    worst_taxel: int

    @property
    def enough(self) -> bool:
        """Return whether the data do not reject one common factor. Two tests are made, so each p-value counts twice."""
        return 2 * min(self.p_shares, self.p_growth) > ALARM


def feel(images_counts: FloatArray, force_n: FloatArray) -> Feel:
    """Sum up a run.

    Args:
        images_counts: (T, J) above rest; what is negative or not a number is nothing.
        force_n: (T,) normal force [N].

    Raises:
        WorkError: too little of it pressed on the skin.
    """
    counts = np.maximum(np.nan_to_num(images_counts), 0.0)
    pressed = np.nan_to_num(force_n) >= _LEAST_N
    if pressed.sum() < _FEWEST or not counts[pressed].sum() > 0:
        raise WorkError(
            f"rolling: expected {_FEWEST} images or more under {_LEAST_N:g} N or more; got {int(pressed.sum())}. "
            "Roll for longer, or look at the force in run.png."
        )
    counts, force = counts[pressed], force_n[pressed]
    total = counts.sum(axis=1)
    hard = force > np.median(force)
    growth = (total[hard].sum() / force[hard].sum()) / max(total[~hard].sum() / force[~hard].sum(), 1e-9)
    shares = counts.sum(axis=0) / total.sum()
    return Feel(float(total.sum() / force.sum()), shares, float(growth))


def wear(hand: Feel, simulated: Sequence[Feel]) -> Wear:
    """Compare a hand with simulated ones.

    Raises:
        WorkError: too few of them.
    """
    count = len(simulated)
    if count < 3:
        raise WorkError(
            f"rescale: expected three simulated hands or more that hold the object; got {count}. Take another policy."
        )
    ratios = np.sort(np.array([hand.counts_per_n / one.counts_per_n for one in simulated]))
    # Unworn, the hand would have each rank among them alike: order statistics of the ratios bound the factor.
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


def rescaled(calibration: Calibration, factor: float) -> Calibration:
    """Return a calibration with a factor of lost sensitivity in its scale.

    The factor says how the hand answers relative to what the draws say of it, so that it is known about as well as the
    scale itself: the interval of the scale is multiplied, not widened.
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
    """Return the share of rows (N, D) that lie at least as far from the mean of all others as the last one does."""
    others = (rows.sum(axis=0) - rows) / (len(rows) - 1)
    far: list[float] = np.linalg.norm(rows - others, axis=1).tolist()
    return sum(one >= far[-1] for one in far) / len(far)
