"""What a model leaves of a session, bin by bin: the numbers of the pictures before and after."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from skincal.gap.signatures import Covariates, covariates_of
from skincal.gap.split import FINAL
from skincal.model.arrays import BoolArray, FloatArray, IntArray

if TYPE_CHECKING:
    from skincal.diagnose.diagnosis import Diagnosis
    from skincal.gap.models import Model
    from skincal.inference.session import GapSession
    from skincal.model import TaxelLayout

FEWEST = 3
"""A bin with values from fewer presses is not shown."""


@dataclass(frozen=True, eq=False)
class Left:
    """Measured less simulated values of a session, N observations of J taxels.

    Attributes:
        residual: (N, J) [counts]; zero where nothing was read.
        weight: (N, J) one over the variance of the noise [1/counts²]; zero where nothing was read.
        values: (N, J) simulated, before the converter [counts].
        white: (N, J) the residual in standard deviations.
        slopes: (N, J, 3) of the simulated values, in standard deviations, by place across and along [1/m] and by the
            logarithm of the force.
        places_m: (P, 2) by how much presses were moved to match, across and along [m].
        distances_m: (N, J) from the contact to the middle of each taxel [m]; NaN where nothing touches.
        session: what was pressed.
        covariates: of the observations.
        layout: of the taxels.
        taxels: (J,) which of the layout's taxels are looked at.
        owner: (N,) press that an observation belongs to, or follows.
        heldout: (N,) of presses that were kept for the end.
    """

    residual: FloatArray
    weight: FloatArray
    values: FloatArray
    white: FloatArray
    slopes: FloatArray
    places_m: FloatArray
    distances_m: FloatArray
    session: GapSession
    covariates: Covariates
    layout: TaxelLayout
    taxels: IntArray
    owner: IntArray
    heldout: BoolArray

    @property
    def touching(self) -> BoolArray:
        """(N, 1) where something presses."""
        return (self.session.press >= 0)[:, None]


def left_by(found: Diagnosis, model: Model) -> Left:
    """What a model of a diagnosis leaves.

    Args:
        found: the diagnosis.
        model: ``choice.before`` or ``choice.after``.
    """
    session, reading = found.material.session, found.material.reading
    slopes, hypothesis = model.refit.slopes, model.hypothesis
    seen = reading.seen
    layout = hypothesis.model.layout
    taxels = np.arange(layout.taxels) if session.taxels is None else session.taxels
    last = np.maximum.accumulate(np.where(session.press >= 0, np.arange(len(session)), -1))
    owner = np.where(last >= 0, session.press[np.maximum(last, 0)], -1)
    gone = np.nan_to_num(reading.counts) - reading.expected(slopes.values)
    part = found.split.part
    return Left(
        np.where(seen, gone, 0.0),
        np.where(seen, 1 / reading.deviation(slopes.values) ** 2, 0.0),
        slopes.values,
        slopes.residual,
        slopes.place,
        hypothesis.places[:, :2],
        _distances(found, model, taxels),
        session,
        covariates_of(session),
        layout,
        taxels,
        owner,
        (owner >= 0) & (part[np.maximum(owner, 0)] == FINAL),
    )


def _distances(found: Diagnosis, model: Model, taxels: IntArray) -> FloatArray:
    """(N, J) straight distances from contacts to taxels [m]."""
    session = model.hypothesis.placed(found.material.session)
    samples, patch = session.samples, model.hypothesis.skin.skin.patch
    centres = np.array([patch.points_m[patch.taxel == j].mean(axis=0) for j in taxels.tolist()])
    points = np.where(samples.touching[:, None], samples.contacts.points_m, np.nan)
    apart = np.linalg.norm(points[:, None] - centres[None], axis=-1)
    seen = np.flatnonzero(session.observation >= 0)
    owner = session.observation[seen]
    total = np.zeros((len(session), len(taxels)))
    np.add.at(total, owner, apart[seen])
    return total / np.bincount(owner, minlength=len(session))[:, None]


@dataclass(frozen=True, eq=False)
class Part:
    """What one line of a picture is made of.

    The line is, in bins of ``x``, the factor by which ``signal`` explains the residual best.

    Attributes:
        label: of the line.
        x: (N, J), or (N, 1) for all taxels.
        signal: (N, J) or (N, 1).
        mask: (N, J) or (N, 1) what is looked at.
        white: whether residual and signal are in standard deviations.
    """

    label: str
    x: FloatArray
    signal: FloatArray
    mask: BoolArray
    white: bool = False


@dataclass(frozen=True, eq=False)
class Line:
    """One line of a picture: values over x, their standard errors, and by how much they lower the squared residual.

    Bin by bin; NaN where there is too little.
    """

    label: str
    x: FloatArray
    y: FloatArray
    error: FloatArray
    fall: FloatArray


def edges_of(parts: tuple[Part, ...], left: Left, bins: int, *, log: bool = False) -> FloatArray:
    """Edges of bins over x, narrower where there is more information.

    Args:
        parts: of a picture.
        left: what is looked at.
        bins: how many at most.
        log: whether x is shown on a logarithmic scale.
    """
    pairs = [_flat(part, left, np.ones(len(left.owner), dtype=np.bool_)) for part in parts]
    if not pairs:
        return np.zeros(0)
    x = np.concatenate([p[0] for p in pairs])
    worth = np.concatenate([p[3] for p in pairs])
    if not len(x) or not worth.sum() > 0:
        return np.zeros(0)
    if len(np.unique(x)) <= bins:
        middle = np.unique(x)
        ends = (middle[1:] + middle[:-1]) / 2
        return np.concatenate([[middle[0] - 1e-9], ends, [middle[-1] + 1e-9]])
    order = np.argsort(x)
    # Half by information, half by length: else small values would share one wide bin.
    share = np.cumsum(np.sqrt(worth[order]))
    along = np.log(np.maximum(x[order], 1e-9)) if log else x[order]
    share = share / share[-1] / 2 + (along - along[0]) / (along[-1] - along[0]) / 2
    cuts = x[order][np.minimum(np.searchsorted(share, np.arange(1, bins) / bins), len(x) - 1)]
    return np.unique(np.concatenate([[x.min() - 1e-9], cuts, [x.max() + 1e-9]]))


def line_of(part: Part, left: Left, edges: FloatArray, rows: BoolArray) -> Line:
    """A line, from some observations.

    Args:
        part: what the line is made of.
        left: what a model leaves.
        edges: (B + 1,) of the bins.
        rows: (N,) observations that are looked at.
    """
    x, owner, pull, worth = _flat(part, left, rows)
    bins = len(edges) - 1
    which = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, bins - 1)
    middle, y, error, fall = (np.full(bins, np.nan) for _ in range(4))
    for k in range(bins):
        own = which == k
        presses, back = np.unique(owner[own], return_inverse=True)
        if len(presses) < FEWEST or not worth[own].sum() > 0:
            continue
        pulls, worths = np.bincount(back, pull[own]), np.bincount(back, worth[own])
        best = pulls.sum() / worths.sum()
        middle[k] = np.average(x[own], weights=worth[own])
        y[k], fall[k] = best, best * pulls.sum()
        # Frames of a press share its errors: what scatters is the press.
        error[k] = np.sqrt(((pulls - best * worths) ** 2).sum()) / worths.sum()
    return Line(part.label, middle, y, error, fall)


def _flat(part: Part, left: Left, rows: BoolArray) -> tuple[FloatArray, IntArray, FloatArray, FloatArray]:
    """x, press, and what residual and signal add to the sums, of all values (M,) that are looked at."""
    shape = left.residual.shape
    residual = left.white if part.white else left.residual
    weight = (left.weight > 0).astype(np.float64) if part.white else left.weight
    x, signal = np.broadcast_to(part.x, shape), np.broadcast_to(part.signal, shape)
    use = np.broadcast_to(part.mask & rows[:, None], shape) & (left.weight > 0)
    use = use & np.isfinite(x) & np.isfinite(signal)
    owner = np.broadcast_to(left.owner[:, None], shape)[use]
    pull, worth = weight * residual * np.nan_to_num(signal), weight * np.nan_to_num(signal) ** 2
    return x[use], owner, pull[use], worth[use]
