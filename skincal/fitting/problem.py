"""The fit problem as arrays: presses on a surface that can be unrolled, and what is known of the rig."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from skincal.errors import WorkError
from skincal.fitting.observe import ImagesAboveRest, Readout, observe
from skincal.fitting.readings import Readings
from skincal.fitting.shared import Shared, smooth_field
from skincal.fitting.types import Bools, Floats, Ints
from skincal.model import Indenter, SensorPose, Surface, TaxelLayout

if TYPE_CHECKING:
    from skincal.fitting.general_skin import ContactMap

ACTIVE_COUNTS = 5.0
"""A taxel of a converter from 0 to 255 is active if it is this far above its rest level [counts] (paper)."""

LEVEL_PART = 0.02
"""Lower bound of the uncertainty of a rest level, as a fraction of the noise of one reading: a numerical tolerance."""

LIT_SIGMAS = 4.0
"""A reading above rest by this multiple of the noise is signal; noise alone does that once in 30 000 readings."""

FEW_PRESSES = 12
"""From this many presses on, the measured positions alone determine the pose; with fewer, the images have to."""

MANY_PRESSES = 16
"""With at least this many presses of two active taxels, presses of one active taxel are not used.

Set by eye. In four sessions with 5 to 20 presses of two active taxels and a noise of one count, fits without
presses of one gave no interval in two sessions and missed E and S in one; with them, all four were right.
Where the noise of hold means is below half a count, presses of one active taxel make the interval of E too
narrow."""

_PARAMETERS, COORDINATES = 5, 2
"""Number of macro parameters, and of coordinates of one contact."""

_ARITHMETIC = 1e-12
"""Relative rounding error of a reading in double precision."""

USED, NO_POSITION = "used", "no position"
"""Status of presses that are used, and of presses without a position."""

COPY = "the very numbers of another press"
"""Status of a press that repeats all numbers of an earlier one."""

_BY_PRESS = ("across_m", "along_m", "force_n", "values", "weight", "saturated", "lit", "indenter", "rows")
"""Attributes with one row per press."""

NO_DENSITY = (
    "no pose, elasticity and scale near the best one explain the presses: their positions, forces and images do not "
    "belong together"
)
"""Message of the error if the posterior is zero everywhere near the peak."""


class FitError(ValueError):
    """The presses do not allow a fit."""


@dataclass(frozen=True, eq=False)
class Rig:
    """The sensor, the indenters, and the accuracy of the measured positions and forces.

    Attributes:
        layout: the taxels.
        surface: the fingertip.
        indenters: the different indenters; a press refers to one by its index.
        readout: the converter.
        position_sigma_m: standard deviation of a measured contact position along each direction [m].
        slack_m: bound of the slack along each direction [m].
        force_scale_sigma: standard deviation of the relative scale error of the force, common to all presses.
        nominal_radius_m: R of arc = R beta at the nominal pose, where R varies with the pose [m].
    """

    layout: TaxelLayout
    surface: Surface
    indenters: tuple[Indenter, ...]
    readout: Readout
    position_sigma_m: float
    slack_m: float
    nominal_radius_m: float | None = None
    force_scale_sigma: float = 0.0

    @property
    def arc_radius_m(self) -> float | None:
        """R of arc = R beta [m], if positions across are arc lengths; None on a plane, where they are x."""
        own = self.surface.arc_radius_m
        return self.nominal_radius_m if own is None else own

    def pose(self, across_m: float, y_m: float, alpha_rad: float) -> SensorPose:
        """Return the sensor pose with its centre at the given position; across is arc length or x [m]."""
        if self.arc_radius_m is None:
            return SensorPose(y_m, alpha_rad, x_m=across_m)
        return SensorPose(y_m, alpha_rad, beta_rad=across_m / self.arc_radius_m)


@dataclass(frozen=True, eq=False)
class PressTable:
    """All presses of a session, as measured.

    Attributes:
        press: (K,) identifiers.
        across_m: (K,) contact position round the surface (arc length of beta; x on a plane) [m].
        along_m: (K,) contact position along y [m].
        force_n: (K,) normal forces [N].
        counts: (K, J) mean counts in the hold.
        indenter: (K,) index of the indenter.
        rest_mean_counts: (J,) mean counts of untouched taxels from idle frames; None if there are none.
        joints_rad: (K, Q) joint angles in the hold; None if there are no joints.
    """

    press: Ints
    across_m: Floats
    along_m: Floats
    force_n: Floats
    counts: Floats
    indenter: Ints
    rest_mean_counts: Floats | None = None
    joints_rad: Floats | None = None


@dataclass(frozen=True, eq=False)
class FitProblem:
    """The presses to fit, prepared for the numerics.

    Attributes:
        rig: sensor, surface, indenters.
        across_m: (K,) measured contact positions [m].
        along_m: (K,) the same along y [m].
        force_n: (K,) forces [N].
        values: (K, J) observed values above rest, with clipping undone; 0 where not read [counts].
        weight: (K, J) derivative of the counts by the value, in [0, 1]; weights normalised images. 0 where a
            taxel was not read or is left out.
        saturated: (K, J) whether the value is only a lower bound.
        lit: (K, J) whether the reading is signal (``LIT_SIGMAS``).
        indenter: (K,) index of the indenter.
        rows: (K,) row of each press in the session's table.
        status: for every press of the session ``used``, or the reason why it was dropped.
        active: for every press of the session, the number of active taxels.
        observed: unclipped values of every press of the session.
        observation: observation model: expected counts and their noise.
        shared: errors that all presses share.
        active_above: value above rest from which a taxel is active [counts].
        min_active: least number of active taxels of a press that is used.
        contacts: contacts in space, for the general way; None if only their position relative to the sensor's
            centre matters.
    """

    rig: Rig
    across_m: Floats
    along_m: Floats
    force_n: Floats
    values: Floats
    weight: Floats
    saturated: Bools
    lit: Bools
    indenter: Ints
    rows: Ints
    status: tuple[str, ...]
    active: Ints
    observed: ImagesAboveRest = field(repr=False)
    observation: Readings = field(repr=False)
    shared: Shared = field(repr=False)
    active_above: float
    min_active: int
    contacts: ContactMap | None = None

    def __len__(self) -> int:
        return len(self.force_n)

    @property
    def _has_two_lit(self) -> Bools:
        """(K,) presses with at least as many lit taxels as coordinates; only those inform the parameters."""
        return np.asarray(self.lit.sum(axis=1) >= COORDINATES, dtype=np.bool_)

    @property
    def readings(self) -> int:
        """Number of lit readings of presses with two or more of them."""
        return int(self.lit[self._has_two_lit].sum())

    @property
    def unknowns(self) -> int:
        """Number of unknowns of those presses: the five parameters, and two coordinates of each press."""
        return _PARAMETERS + COORDINATES * int(self._has_two_lit.sum())

    @property
    def has_one_taxel(self) -> Bools:
        """(K,) presses with fewer active taxels than coordinates; their image does not determine their position."""
        return np.asarray(self.active[self.rows] < COORDINATES, dtype=np.bool_)

    @property
    def for_grid(self) -> FitProblem:
        """The presses that the grid uses: those with two active taxels or more; all if there are too few of these."""
        enough = ~self.has_one_taxel
        return self.subset(enough, "one active taxel") if enough.sum() >= _PARAMETERS else self

    @property
    def determined(self) -> bool:
        """Return whether the images can determine the parameters.

        With few presses, and no more readings than unknowns, many different sensors match the readings
        exactly. The result then depends on the assumptions about the rig. In simulated sessions of 3 to 8
        presses without a spare reading, one in six had an interval that missed the truth; with one spare
        reading or more, none had.
        """
        return len(self) >= FEW_PRESSES or self.readings > self.unknowns

    @property
    def used(self) -> Bools:
        """(K, J) readings that count."""
        return self.weight > 0

    @property
    def alive(self) -> Bools:
        """(J,) taxels with at least one reading that counts."""
        return np.asarray(self.used.any(axis=0), dtype=np.bool_)

    @property
    def noise_sigma_counts(self) -> float:
        """Noise of a hold mean of a taxel away from the bounds [counts], from the scatter of untouched taxels."""
        return self.observation.noise_counts

    @property
    def scales(self) -> tuple[float, float]:
        """Lower and upper bound of the scale S [1/N]: four decades about the typical signal per newton."""
        usual = self.observation.typical_counts / float(np.median(self.force_n))
        return 1e-4 * usual, 1e4 * usual

    def subset(self, keep: Bools, reason: str) -> FitProblem:
        """Return the problem with the presses (K,) to keep; the others get ``reason`` as their status."""
        status = list(self.status)
        for row in self.rows[~keep]:
            status[row] = reason
        return replace(
            self,
            **{name: getattr(self, name)[keep] for name in _BY_PRESS},
            status=tuple(status),
            observation=self.observation.subset(keep),
            shared=self.shared.for_presses(keep),
        )

    def with_shared(self, theta: Floats) -> FitProblem:
        """Return the problem with other values (T,) of the errors that all presses share."""
        return replace(self, shared=self.shared.with_theta(theta))

    def with_signal(self, simulated: Floats) -> FitProblem:
        """Return the problem with the noise of its readings computed from simulated values (K, J)."""
        return replace(self, observation=self.observation.at(simulated))

    def without_taxels(self, dead: Bools) -> FitProblem:
        """Return the problem with some taxels (J,) left out of every residual."""
        return self.without_readings(np.broadcast_to(dead, self.values.shape))

    def without_readings(self, lost: Bools) -> FitProblem:
        """Return the problem with some readings (K, J) left out."""
        return replace(
            self,
            values=np.where(lost, 0.0, self.values),
            weight=np.where(lost, 0.0, self.weight),
            saturated=self.saturated & ~lost,
            lit=self.lit & ~lost,
        )


def build_problem(
    rig: Rig, presses: PressTable, *, active_counts: float | None = None, min_active: int | None = None
) -> FitProblem:
    """Choose the presses to fit (paper, section III-A: at least two active taxels) and clean their values.

    If few presses have two active taxels, those with one are used as well: their dark neighbours show how far
    an image does not spread.

    Args:
        rig: sensor, surface, indenters.
        presses: the session.
        active_counts: value above the rest level from which a taxel is active; None for :func:`active_threshold`.
        min_active: least number of active taxels of a press; None for two, or one if few presses have two.

    Returns:
        The problem; its ``status`` says why a press is not used.

    Raises:
        WorkError: no reading is above the noise.
    """
    seen = observe(presses.counts, rig.readout, presses.rest_mean_counts)
    read = np.isfinite(seen.values)
    threshold = active_threshold(seen, rig.readout) if active_counts is None else active_counts
    active = (np.where(read, seen.values, 0.0) >= threshold).sum(axis=1)
    copies = _find_copies(presses)
    if min_active is None:
        placed = np.isfinite(presses.across_m + presses.along_m) & (presses.force_n > 0) & ~copies
        min_active = COORDINATES if (placed & (active >= COORDINATES)).sum() >= MANY_PRESSES else 1
    status = [
        COPY if copies[k] else _describe_status(k, presses, read, int(active[k]), min_active, threshold)
        for k in range(len(presses.press))
    ]
    rows = np.array([k for k, s in enumerate(status) if s == USED], dtype=np.intp)
    values = np.where(read, seen.values, 0.0)[rows]
    readings = Readings.of(seen, presses.counts, rig.readout, rig.layout, rows)
    lit = (values > LIT_SIGMAS * readings.noise_counts) & read[rows]
    if len(rows) and not lit.any():
        raise WorkError(
            f"no taxel stands clear of the noise of {readings.noise_counts:.2g} counts in any press: the largest value "
            f"above rest is {values.max():.3g}. Do the counts grow with load?"
        )
    across, along = presses.across_m[rows], presses.along_m[rows]
    posture = np.empty((len(presses.press), 0)) if presses.joints_rad is None else presses.joints_rad
    return FitProblem(
        rig,
        across,
        along,
        presses.force_n[rows],
        values,
        np.where(read[rows], seen.slope[rows], 0.0),
        seen.saturated[rows] & read[rows],
        lit,
        presses.indenter[rows],
        rows,
        tuple(status),
        active.astype(np.intp),
        seen,
        readings,
        Shared.none(
            np.maximum(seen.level_sigma_counts, LEVEL_PART * readings.noise_counts),
            *smooth_field(
                np.column_stack([presses.across_m, presses.along_m]), presses.force_n, posture, rows
            ),
        ),
        threshold,
        min_active,
    )


def active_threshold(seen: ImagesAboveRest, readout: Readout, *, untouched: bool = True) -> float:
    """Return the value above rest from which a taxel is active, in the unit of the data.

    The paper's 5 counts are 2 % of its converter's range. If that is more than 4 % of the largest value, or
    if the range is not known, the threshold is those 4 %. It is never less than five times the noise.

    Args:
        seen: unclipped values of the session.
        readout: of the converter.
        untouched: whether some presses leave taxels untouched, so that those show the noise.
    """
    largest = float(np.nanmax(seen.values, initial=0.0))
    low, high = readout.value_min, readout.value_max
    span = np.inf if low is None or high is None else ACTIVE_COUNTS / 255.0 * (high - low)
    noise = seen.rest_sigma_counts if untouched and np.isfinite(seen.rest_sigma_counts) else 0.0
    if not untouched and np.isfinite(span):
        return span  # the noise is unknown, and 4 % of the largest value may be noise
    # The difference of equal readings in floating point is not exactly zero; it is no signal.
    whole = float(
        np.nanmax(np.abs(np.nan_to_num(seen.rest_counts)) + np.abs(np.nan_to_num(seen.values)), initial=0.0)
    )
    return max(5.0 * noise, min(span, 0.04 * largest), _ARITHMETIC * whole, np.finfo(float).tiny)


def _find_copies(presses: PressTable) -> Bools:
    """Return which presses (K,) repeat every number of an earlier one.

    No two measurements agree to the last digit. A copy adds no information, but would count as if it did.
    """
    numbers = np.column_stack([presses.across_m, presses.along_m, presses.force_n, presses.counts])
    first = np.unique(np.nan_to_num(numbers, nan=-1.0), axis=0, return_index=True)[1]
    copies = np.ones(len(numbers), dtype=bool)
    copies[first] = False
    return copies


def _describe_status(
    k: int, presses: PressTable, read: Bools, active: int, min_active: int, active_counts: float
) -> str:
    """Return ``USED``, or the reason why press ``k`` is not used."""
    if not (np.isfinite(presses.force_n[k]) and presses.force_n[k] > 0):
        return "no positive force"
    if not (np.isfinite(presses.across_m[k]) and np.isfinite(presses.along_m[k])):
        return NO_POSITION
    if not read[k].any():
        return "no taxel read"
    if active < min_active:
        taxels = "taxel" if active == 1 else "taxels"
        return f"{active} active {taxels} (at least {min_active} above {active_counts:.3g} counts are needed)"
    return USED
