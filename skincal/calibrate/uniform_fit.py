"""A calibration from uniform pressure: the scale of each taxel, and infinite intervals for pose and elasticity."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from skincal.calibrate.assemble import make_provenance
from skincal.calibrate.data_findings import adapt_to_rig
from skincal.calibrate.problem import search_box
from skincal.calibration import MARGIN_M, Calibration, Finding, Loss, ModelParameters, Provenance
from skincal.dataset import Dataset, idle_means
from skincal.dataset.dataset import refusal
from skincal.dataset.uniform_pressure import UNIFORM, centre_contacts, zero_load_levels
from skincal.fitting.fit_options import FitOptions
from skincal.fitting.observe import Readout, observe
from skincal.fitting.problem import active_threshold
from skincal.fitting.result import OPEN
from skincal.fitting.types import Bools, Floats
from skincal.fitting.uniform_scales import Scales, bootstrap_common_scale, fit_scales
from skincal.model import Contacts
from skincal.shown import Shown
from skincal.units import deg

DRAWS = 200
"""Number of bootstrap draws."""
ZERO_COUNTS = 1.0
"""Median offset of the lines from which it is reported [counts]."""


@dataclass(frozen=True, eq=False)
class UniformOutcome(Shown):
    """A calibration from uniform pressure, and what it was computed from.

    Attributes:
        calibration: S of each taxel; pose and E as given.
        scales: the fitted scales.
        loads_n: (K, J) load of each taxel in each press [N].
        values: (K, J) values above the rest level [counts].
        use: (K, J) values that were used: read, and not saturated.
    """

    calibration: Calibration
    scales: Scales
    loads_n: Floats
    values: Floats
    use: Bools

    def __repr__(self) -> str:
        return f"<UniformOutcome {self.calibration!r}>"


def calibrate_uniform(
    dataset: Dataset,
    *,
    active_counts: float | None = None,
    level: float = FitOptions().level,
    seed: int = 0,
    command: str = "",
) -> UniformOutcome:
    """Fit the scale of every taxel from presses that load all of them alike.

    Args:
        dataset: a flat punch larger than the patch in every press.
        active_counts: value above rest that a taxel must reach in two presses; None to derive it from the data.
        level: probability content of the interval of S.
        seed: of the bootstrap behind that interval.
        command: command line, for the provenance.

    Raises:
        WorkError: no press has a force, or no taxel responds.
    """
    meta, presses = dataset.meta, dataset.presses
    sensor = meta.sensor
    pressed = np.isfinite(presses.force_n) & (presses.force_n > 0)
    if not pressed.any():
        raise refusal(
            dataset, "no press has a force above 0. Write the pressure times the area of the punch in force_n"
        )
    readout = Readout(sensor.value_min, sensor.value_max, sensor.integer, sensor.baseline == "subtracted")
    rest = idle_means(dataset)
    rest_known = rest is not None
    if rest is None:
        # Without frames at rest an approximate level suffices, as lines need not pass through the
        # origin.
        rest = zero_load_levels(dataset)
    seen = observe(presses.counts, readout, rest)
    if active_counts is None:
        active_counts = active_threshold(seen, readout, untouched=False)
    use = np.isfinite(presses.counts) & ~seen.saturated & pressed[:, None]
    one = _assume_calibration(dataset)
    loads = _unit_scale_loads(one, dataset)
    scales = fit_scales(loads, seen.values, use, active_counts, rest_known=rest_known)
    if not scales.responding.any():
        raise refusal(
            dataset,
            f"no taxel rises by more than {active_counts:.3g} counts in two presses: nothing can be calibrated. "
            "Press harder, or lower --active-counts",
        )
    rng = np.random.default_rng(seed)
    draws = bootstrap_common_scale(loads, seen.values, use, active_counts, DRAWS, rng, rest_known=rest_known)
    low, high = np.quantile(draws, [(1 - level) / 2, (1 + level) / 2])
    mean_square = float(np.nanmean(scales.residual**2))
    noise = {"noise_sigma_counts": seen.frame_sigma_counts} if np.isfinite(seen.frame_sigma_counts) else {}
    loss = Loss(mean_square, mean_square, int(pressed.sum()), extra=noise)
    settings = {"method": "uniform pressure", "active_counts": active_counts, "level": level}
    calibration = replace(
        one,
        model=replace(
            one.model,
            scale_per_n=scales.common_per_n,
            scale_per_taxel_per_n=tuple(scales.scale_per_n.tolist()),
            rest_counts=None
            if readout.rest_subtracted
            else _common_rest(rest, scales, rest_known=rest_known),
        ),
        intervals={**one.intervals, "scale_per_n": (float(low), float(high))},
        loss=loss,
        provenance=make_provenance(dataset, command, seed, settings),
        findings=_build_findings(scales, dataset),
    )
    return UniformOutcome(calibration, scales, loads, seen.values, use)


def _common_rest(level: Floats, scales: Scales, *, rest_known: bool) -> float:
    """Return the rest level that taxels share [counts], by their lines at no load if it was not seen."""
    own = level if rest_known else level + scales.offset_counts
    return float(np.median(own[scales.responding & np.isfinite(own)]))


def _assume_calibration(dataset: Dataset) -> Calibration:
    """Return the assumed calibration with S = 1: the nominal pose, and no bounded parameter."""
    pose, plane = dataset.nominal_pose(), dataset.meta.surface.is_plane
    low, high = search_box(dataset).elasticity_pa_per_m
    model = ModelParameters(
        pose.y_m, deg(pose.alpha_rad), float(np.sqrt(low * high)), 1.0,
        beta_deg=None if plane else deg(pose.beta_rad), x_m=pose.x_m if plane else None,
    )  # fmt: skip
    intervals = dict.fromkeys(model.best(), OPEN)
    loss, provenance = Loss(0.0, 0.0, 0), Provenance("")
    return Calibration.of_dataset(dataset, model=model, intervals=intervals, loss=loss, provenance=provenance)


def _unit_scale_loads(one: Calibration, dataset: Dataset) -> Floats:
    """Return the loads (K, J) of a skin of unit scale [N]; cells of half a taxel are fine enough."""
    placed = centre_contacts(dataset, MARGIN_M)
    skin = one.base_skin(float(one.layout().sizes_m.min()) / 2)
    points = one.surface_model().project(placed.presses.position_m)
    contacts = Contacts(points, one.surface_model().normal_at(points), placed.presses.force_n)
    return skin.loads(placed.indenter(), contacts)


def _build_findings(scales: Scales, dataset: Dataset) -> tuple[Finding, ...]:
    """Return the findings of a fit to uniform pressure."""
    found = [
        Finding(
            "uniform_pressure",
            "warning",
            f"{UNIFORM[0].upper()}{UNIFORM[1:]}, and was; pose and elasticity stand as they were assumed.",
        )
    ]
    silent = np.flatnonzero(~scales.responding)
    if len(silent):
        found.append(
            Finding(
                "no_answer",
                "warning",
                f"{len(silent)} of {len(scales.responding)} taxels do not answer: "
                f"{dataset.layout().names(silent)}. "
                "They are dead, stuck, or at the end of their range; their scale is set to 0.",
                "Look at them with `skincal dataset show`.",
            )
        )
    zero = float(np.median(scales.offset_counts[scales.responding]))
    if idle_means(dataset) is not None and abs(zero) > ZERO_COUNTS:
        newtons = -zero / scales.common_per_n
        found.append(
            Finding(
                "zero_of_force",
                "info",
                f"The lines of the taxels meet no load at {zero:+.1f} counts (median): as if the load of each were "
                f"{abs(newtons):.3g} N {'less' if newtons > 0 else 'more'} than was measured.",
                "Look at the zero of the pressure gauge, and at whether the skin answers to small pressures at all.",
            )
        )
    return adapt_to_rig(tuple(found), dataset)
