"""The problem of a fit, as arrays: presses on a surface that can be unrolled, and the knowledge of the rig."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from skincal.errors import WorkError
from skincal.fitting.general_contacts import ContactMap
from skincal.fitting.observe import Observed, Readout, observe
from skincal.fitting.readings import Readings
from skincal.fitting.shared import Shared, smooth_field
from skincal.fitting.types import Bools, Floats, Ints
from skincal.model import Indenter, SensorPose, Surface, TaxelLayout

ACTIVE_COUNTS = 5.0
"""A taxel of a converter from 0 to 255 answers when it stands this far above its level at rest [counts] (paper)."""

LEVEL_PART = 0.02
"""A level at rest is never better known than this part of the noise of one reading: a numerical tolerance."""

LIT_SIGMAS = 4.0
"""A reading so many times the noise above rest is no noise: one in 30 000 is."""

FEW_PRESSES = 12
"""From so many presses on their measured places alone tell the pose; of fewer, the images have to."""

MANY_PRESSES = 16
"""So many presses with two active taxels do without those with one.

Set by eye: of four sessions with 5 to 20 such presses and a noise of one count, two had no interval and one missed E
and S without those with one, and all were right with them. Where hold means are better than half a count,
presses with one make E too sharp."""

_PARAMETERS, COORDINATES = 5, 2

_ARITHMETIC = 1e-12
"""Part of a reading that rounding of double precision leaves."""

USED, NO_POSITION = "used", "no position"

COPY = "the very numbers of another press"

_BY_PRESS = ("across_m", "along_m", "force_n", "values", "weight", "saturated", "lit", "indenter", "rows")

NOWHERE = (
    "no pose, elasticity and scale near the best one explain the presses: their positions, forces and images do not "
    "belong together"
)


class FitError(ValueError):
    """The presses do not allow a fit."""


@dataclass(frozen=True, eq=False)
class Rig:
    """The sensor, what presses on it, and how well it is known where.

    Attributes:
        layout: the taxels.
        surface: the fingertip.
        indenters: the different indenters; a press names one by its index.
        readout: the converter.
        position_sigma_m: what the rig's contact position is worth, one sigma along each direction [m].
        slack_m: bound of the slack along each direction [m].
        force_scale_sigma: what the scale of the forces is worth: relative error, one for all presses, one sigma.
        nominal_radius_m: where R of arc = R beta varies with the pose, that at the nominal one [m].
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
        """R of arc = R beta [m]: positions across are arcs; None on a plane, where they are x."""
        own = self.surface.arc_radius_m
        return self.nominal_radius_m if own is None else own

    def pose(self, across_m: float, y_m: float, alpha_rad: float) -> SensorPose:
        """Return the pose of the sensor whose centre lies there, across as arc or x [m]."""
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
        rest_mean_counts: (J,) mean counts of untouched taxels from idle frames; None where there are none.
        joints_rad: (K, Q) joint angles in the hold; None where there are no joints.
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
    """The presses that are fitted, ready for the numerics.

    Attributes:
        rig: sensor, surface, indenters.
        across_m: (K,) measured contact positions [m].
        along_m: (K,) the same along y [m].
        force_n: (K,) forces [N].
        values: (K, J) observed values above rest, as clipping is undone; 0 where not read [counts].
        weight: (K, J) how much of a change of the value the counts show, in [0, 1]; weighs normalised images. 0 where a
            taxel was not read or is left out.
        saturated: (K, J) the value is a lower bound.
        lit: (K, J) taxels that answered.
        indenter: (K,) index of the indenter.
        rows: (K,) row of each press in the session's table.
        status: for every press of the session ``used``, or why it was dropped.
        active: for every press of the session, how many taxels answered.
        observed: what the counts became, for every press of the session.
        observation: expected counts and their noise.
        shared: errors that all presses share.
        active_above: value above rest from which a taxel is active [counts].
        min_active: presses were taken that have so many active taxels.
        contacts: where presses lie in space, for the general way; None where only their place relative to the
            sensor's centre matters.
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
    observed: Observed = field(repr=False)
    observation: Readings = field(repr=False)
    shared: Shared = field(repr=False)
    active_above: float
    min_active: int
    contacts: ContactMap | None = None

    def __len__(self) -> int:
        return len(self.force_n)

    @property
    def _telling(self) -> Bools:
        """(K,) presses with as many lit taxels as they have coordinates, or more; others tell no parameter alone."""
        return np.asarray(self.lit.sum(axis=1) >= COORDINATES, dtype=np.bool_)

    @property
    def readings(self) -> int:
        """Number of values of lit taxels, of presses with two or more."""
        return int(self.lit[self._telling].sum())

    @property
    def unknowns(self) -> int:
        """Return what they have to tell: the five parameters, and both coordinates of every one of these presses."""
        return _PARAMETERS + COORDINATES * int(self._telling.sum())

    @property
    def lone(self) -> Bools:
        """(K,) presses with fewer active taxels than coordinates: their image alone does not tell their place."""
        return np.asarray(self.active[self.rows] < COORDINATES, dtype=np.bool_)

    @property
    def on_grid(self) -> FitProblem:
        """The presses whose normalised image tells something: two active taxels or more; all where few have those."""
        enough = ~self.lone
        return self.subset(enough, "one active taxel") if enough.sum() >= _PARAMETERS else self

    @property
    def determined(self) -> bool:
        """Return whether the images can tell the parameters.

        Of few presses, no more readings than unknowns are matched exactly by many different sensors; which of them
        comes out then depends on what was assumed of the rig. Of simulated sessions of 3 to 8 presses, one in six
        without a spare reading had an interval that missed the truth, and of those with one none had.
        """
        return len(self) >= FEW_PRESSES or self.readings > self.unknowns

    @property
    def used(self) -> Bools:
        """(K, J) which readings count."""
        return self.weight > 0

    @property
    def alive(self) -> Bools:
        """(J,) taxels of which any reading counts."""
        return np.asarray(self.used.any(axis=0), dtype=np.bool_)

    @property
    def noise_sigma_counts(self) -> float:
        """Noise of a hold mean of a taxel away from the bounds [counts], from the scatter of untouched taxels."""
        return self.observation.noise_counts

    @property
    def scales(self) -> tuple[float, float]:
        """Any scale S within these is considered [1/N]: about the usual signal of a newton, whatever its unit."""
        usual = self.observation.typical_counts / float(np.median(self.force_n))
        return 1e-4 * usual, 1e4 * usual

    def subset(self, keep: Bools, reason: str) -> FitProblem:
        """The problem without some of its presses; those get ``reason`` for their status."""
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
        """The problem with other values (T,) of the errors that all presses share."""
        return replace(self, shared=self.shared.with_theta(theta))

    def with_signal(self, simulated: Floats) -> FitProblem:
        """The problem with the noise of its readings as simulated values (K, J) have it."""
        return replace(self, observation=self.observation.at(simulated))

    def without_taxels(self, dead: Bools) -> FitProblem:
        """The problem with some taxels (J,) left out of every residual."""
        return self.without_readings(np.broadcast_to(dead, self.values.shape))

    def without_readings(self, lost: Bools) -> FitProblem:
        """The problem with some readings (K, J) left out."""
        return replace(
            self,
            values=np.where(lost, 0.0, self.values),
            weight=np.where(lost, 0.0, self.weight),
            saturated=self.saturated & ~lost,
            lit=self.lit & ~lost,
        )


def pose_problem(
    rig: Rig, presses: PressTable, *, active_counts: float | None = None, min_active: int | None = None
) -> FitProblem:
    """Choose the presses to fit (paper, section III-A: at least two active taxels) and clean their values.

    Where few presses have two, those with one are taken as well: that the neighbours stay dark says how far an image
    does not spread.

    Args:
        rig: sensor, surface, indenters.
        presses: the session.
        active_counts: a taxel is active from so much above its level at rest; None for what the data say
            (:func:`active_threshold`).
        min_active: a press is used from so many active taxels; None for two, or one where few presses have two.

    Returns:
        The problem; its ``status`` says of every press why it is not used.
    """
    seen = observe(presses.counts, rig.readout, presses.rest_mean_counts)
    read = np.isfinite(seen.values)
    threshold = active_threshold(seen, rig.readout) if active_counts is None else active_counts
    active = (np.where(read, seen.values, 0.0) >= threshold).sum(axis=1)
    copies = _copies(presses)
    if min_active is None:
        placed = np.isfinite(presses.across_m + presses.along_m) & (presses.force_n > 0) & ~copies
        min_active = COORDINATES if (placed & (active >= COORDINATES)).sum() >= MANY_PRESSES else 1
    status = [
        COPY if copies[k] else _status(k, presses, read, int(active[k]), min_active, threshold)
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


def active_threshold(seen: Observed, readout: Readout, *, untouched: bool = True) -> float:
    """Value above rest from which a taxel answers, in the unit of the data.

    The paper's 5 counts are 2 % of its converter's range. Where that is more than 4 % of the largest value, or the
    range is not known, it is the 4 %; and never less than five times the noise.

    Args:
        seen: what the counts became.
        readout: of the converter.
        untouched: whether some presses leave taxels alone, so that those show the noise.
    """
    largest = float(np.nanmax(seen.values, initial=0.0))
    low, high = readout.value_min, readout.value_max
    span = np.inf if low is None or high is None else ACTIVE_COUNTS / 255.0 * (high - low)
    noise = seen.rest_sigma_counts if untouched and np.isfinite(seen.rest_sigma_counts) else 0.0
    if not untouched and np.isfinite(span):
        return span  # nothing shows the noise, and a part of the largest value may be all noise
    # What a subtraction of equal readings leaves is no signal.
    whole = float(
        np.nanmax(np.abs(np.nan_to_num(seen.rest_counts)) + np.abs(np.nan_to_num(seen.values)), initial=0.0)
    )
    return max(5.0 * noise, min(span, 0.04 * largest), _ARITHMETIC * whole, np.finfo(float).tiny)


def _copies(presses: PressTable) -> Bools:
    """Return which presses (K,) have every number of an earlier one.

    No two measurements are alike to the last digit. A copy adds nothing, and would count as if it did.
    """
    numbers = np.column_stack([presses.across_m, presses.along_m, presses.force_n, presses.counts])
    first = np.unique(np.nan_to_num(numbers, nan=-1.0), axis=0, return_index=True)[1]
    copies = np.ones(len(numbers), dtype=bool)
    copies[first] = False
    return copies


def _status(
    k: int, presses: PressTable, read: Bools, active: int, min_active: int, active_counts: float
) -> str:
    if not (np.isfinite(presses.force_n[k]) and presses.force_n[k] > 0):
        return "no positive force"
    if not (np.isfinite(presses.across_m[k]) and np.isfinite(presses.along_m[k])):
        return NO_POSITION
    if not read[k].any():
        return "no taxel read"
    if active < min_active:
        taxels = "taxel" if active == 1 else "taxels"
        return f"{active} active {taxels} (at least {min_active} above {active_counts:g} counts are needed)"
    return USED
