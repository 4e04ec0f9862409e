"""What is to be fitted, as arrays: presses on a surface that can be unrolled, and what is known of the rig."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from skincal.errors import WorkError
from skincal.fit.general_contacts import ContactMap
from skincal.fit.observe import Observed, Readout, clipped_share, observe
from skincal.fit.types import Bools, Floats, Ints
from skincal.model import Cylinder, Indenter, Surface, TaxelLayout

ACTIVE_COUNTS = 5.0
"""A taxel answers when it stands this far above its level at rest [counts]."""

FEW_PRESSES = 12
"""From so many presses on their measured places alone tell the pose; of fewer, the images have to."""

_PARAMETERS = 5

USED, NO_POSITION = "used", "no position"

COPY = "the very numbers of another press"

_BY_PRESS = ("across_m", "along_m", "force_n", "values", "weight", "saturated", "lit", "indenter", "rows")


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
        mesh_radius_m: on a mesh the R that relates arc and angle round the finger, arc = R beta [m].
    """

    layout: TaxelLayout
    surface: Surface
    indenters: tuple[Indenter, ...]
    readout: Readout
    position_sigma_m: float
    slack_m: float
    mesh_radius_m: float | None = None
    force_scale_sigma: float = 0.0

    @property
    def arc_radius_m(self) -> float | None:
        """R of arc = R beta [m]: positions across are arcs; None on a plane, where they are x."""
        return self.surface.radius_m if isinstance(self.surface, Cylinder) else self.mesh_radius_m


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
        active: (K,) how many taxels answered; None to count those that stand ``active_counts`` above rest.
    """

    press: Ints
    across_m: Floats
    along_m: Floats
    force_n: Floats
    counts: Floats
    indenter: Ints
    rest_mean_counts: Floats | None = None
    active: Ints | None = None


@dataclass(frozen=True, eq=False)
class FitProblem:
    """The presses that are fitted, ready for the numerics.

    Attributes:
        rig: sensor, surface, indenters.
        across_m: (K,) measured contact positions [m].
        along_m: (K,) the same along y [m].
        force_n: (K,) forces [N].
        values: (K, J) observed values above rest; 0 where not read [counts].
        weight: (K, J) weight of a residual, in [0, 1]; 0 where a taxel was not read.
        saturated: (K, J) the value is a lower bound.
        lit: (K, J) taxels that answered; they carry the noise estimate.
        indenter: (K,) index of the indenter.
        rows: (K,) row of each press in the session's table.
        status: for every press of the session ``used``, or why it was dropped.
        active: for every press of the session, how many taxels answered.
        observed: what the counts became, for every press of the session.
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
    contacts: ContactMap | None = None

    def __len__(self) -> int:
        return len(self.force_n)

    @property
    def readings(self) -> int:
        """How many values of lit taxels there are."""
        return int(self.lit.sum())

    @property
    def unknowns(self) -> int:
        """What they have to tell: the five parameters, and both coordinates of every press."""
        return _PARAMETERS + 2 * len(self)

    @property
    def determined(self) -> bool:
        """Whether the images can tell the parameters.

        Of few presses, no more readings than unknowns are matched exactly by many different sensors; which of them
        comes out then depends on what was assumed of the rig. Of simulated sessions of 3 to 8 presses, one in six
        without a spare reading had an interval that missed the truth, and of those with one none had.
        """
        return len(self) >= FEW_PRESSES or self.readings > self.unknowns

    @property
    def dark_squares(self) -> Floats:
        """(K,) weighted squares of what the dark taxels read.

        They say nothing of the fit and are taken off its loss, so that many dark taxels do not make the few lit ones
        look better fitted than they are.
        """
        return (np.where(self.lit, 0.0, self.weight * self.values) ** 2).sum(axis=1)

    @property
    def noise_sigma_counts(self) -> float:
        """Noise of a hold mean of a taxel away from the bounds [counts], from the scatter of untouched taxels.

        Clipping takes four tenths off the scatter of a taxel at rest on its bound; that is undone. Where no taxel is
        ever untouched, one percent of the largest value stands in.
        """
        scatter, frame = self.observed.rest_sigma_counts, self.observed.frame_sigma_counts
        if not np.isfinite(scatter) or scatter <= 0:
            return max(0.1, 0.01 * float(self.values.max(initial=0.0)))
        if not np.isfinite(frame):
            return max(scatter, 0.05)
        share = clipped_share(self.rig.readout.value_min or 0.0, frame, self.rig.readout)
        return max(scatter / max(share, 0.2), 0.05)

    def subset(self, keep: Bools, reason: str) -> FitProblem:
        """The problem without some of its presses; those get ``reason`` for their status."""
        status = list(self.status)
        for row in self.rows[~keep]:
            status[row] = reason
        return replace(
            self,
            **{name: getattr(self, name)[keep] for name in _BY_PRESS},
            status=tuple(status),
        )

    def without_taxels(self, dead: Bools) -> FitProblem:
        """The problem with some taxels (J,) left out of every residual."""
        return replace(
            self,
            values=np.where(dead[None, :], 0.0, self.values),
            weight=np.where(dead[None, :], 0.0, self.weight),
            saturated=self.saturated & ~dead[None, :],
            lit=self.lit & ~dead[None, :],
        )


def pose_problem(
    rig: Rig, presses: PressTable, *, active_counts: float = ACTIVE_COUNTS, min_active: int = 2
) -> FitProblem:
    """Choose the presses to fit (paper, section III-A: at least two active taxels) and clean their values.

    Args:
        rig: sensor, surface, indenters.
        presses: the session.
        active_counts: a taxel is active from so many counts above its level at rest.
        min_active: a press is used from so many active taxels.

    Returns:
        The problem; its ``status`` says of every press why it is not used.
    """
    seen = observe(presses.counts, rig.readout, presses.rest_mean_counts)
    read = np.isfinite(seen.values)
    active = presses.active
    if active is None:
        active = (np.where(read, seen.values, 0.0) >= active_counts).sum(axis=1)
    copies = _copies(presses)
    status = [
        COPY if copies[k] else _status(k, presses, read, int(active[k]), min_active, active_counts)
        for k in range(len(presses.press))
    ]
    rows = np.array([k for k, s in enumerate(status) if s == USED], dtype=np.intp)
    dark_below = max(4.0 * (seen.rest_sigma_counts if np.isfinite(seen.rest_sigma_counts) else 0.1), 0.5)
    values = np.where(read, seen.values, 0.0)[rows]
    dark = values < dark_below
    if len(rows) and not (~dark & read[rows]).any():
        raise WorkError(
            f"no taxel reads {dark_below:.2g} counts more than at rest in any press: expected counts of a converter; "
            f"got {values.max():.3g} at most. Of volts or shares multiply taxels, value_min and value_max, say by 255"
        )
    return FitProblem(
        rig,
        presses.across_m[rows],
        presses.along_m[rows],
        presses.force_n[rows],
        values,
        np.where(read[rows], seen.slope[rows], 0.0),
        seen.saturated[rows] & read[rows],
        ~dark & read[rows],
        presses.indenter[rows],
        rows,
        tuple(status),
        active.astype(np.intp),
        seen,
    )


def _copies(presses: PressTable) -> Bools:
    """Which presses (K,) have every number of an earlier one.

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
