"""The audit of a dataset or of a plan: what its presses can show, what not, and why."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from skincal.calibration import Calibration, check_same_sensor, sensor_differences
from skincal.collect import Mount, Plan
from skincal.dataset import Dataset
from skincal.dataset.refusal import refusal
from skincal.diagnose.base import (
    GUESSED_PA_PER_M,
    GUESSED_PER_N,
    calibrated_model,
    floor_of,
    guessed_model,
    hold_slopes,
    thinned,
)
from skincal.diagnose.phases import check_phases
from skincal.diagnose.plan import plan_session
from skincal.diagnose.session import gap_session
from skincal.errors import InputError
from skincal.fit.observe import Readout
from skincal.gap.audit import AuditOptions, EffectAudit, audit, linearise
from skincal.gap.base import BaseColumns, BaseModel, base_columns, resolution_of
from skincal.gap.noise import NoiseFloor, assumed_floor
from skincal.gap.reasons import facts_of, why_not
from skincal.inference.session import GapSession
from skincal.robot import HandDescription

STRONG, OUT_OF_PROPORTION, FEWEST = 0.9, 10.0, 5
"""A force is no measurement if it is so many times the one that so large a share of so many presses stays below."""


@dataclass(frozen=True, eq=False)
class AuditReport:
    """What a session can show.

    Attributes:
        effects: what was found of each effect, in the order of the chain.
        reasons: why an effect is not visible, by name.
        floor: the noise.
        presses: number of presses.
        observations: number of images that were looked at, means over a few frames each.
        taxels: number of taxels that were looked at, evenly spread over those that presses reach.
        has_frames: whether they are of frames; else hold means.
        calibrated: whether pose, E and S are a calibration's; else they are guessed.
        planned: whether there are no data yet, and the noise is assumed.
        options: false alarm, power, and what positions and forces are worth.
        left_out: numbers of presses whose force is out of all proportion.
    """

    effects: Mapping[str, EffectAudit]
    reasons: Mapping[str, str]
    floor: NoiseFloor
    presses: int
    observations: int
    taxels: int
    has_frames: bool
    calibrated: bool
    planned: bool
    options: AuditOptions
    left_out: tuple[int, ...] = ()

    @property
    def visible(self) -> tuple[str, ...]:
        """Effects whose typical case is found."""
        return tuple(name for name, found in self.effects.items() if found.visible)

    @property
    def cannot_see(self) -> tuple[str, ...]:
        """The other effects."""
        return tuple(name for name, found in self.effects.items() if not found.visible)

    @property
    def rows(self) -> list[dict[str, Any]]:
        """What is said of each effect, as plain values; an infinite strength is None."""
        return [
            {
                "name": name,
                "visible": one.visible,
                "distance": one.distance,
                "smallest_strength": one.smallest_strength if np.isfinite(one.smallest_strength) else None,
                "consistent_with": list(one.consistent_with),
                "lacking": list(one.lacking),
                "reason": self.reasons.get(name),
            }
            for name, one in self.effects.items()
        ]


def audit_dataset(dataset: Dataset, calibration: Calibration | None, rng: np.random.Generator) -> AuditReport:
    """Audits a dataset.

    Args:
        dataset: the session.
        calibration: gives pose, E and S, and what positions and forces are worth; None: they are guessed.
        rng: for intervals, and for cases that vary from taxel to taxel.

    Raises:
        InputError: the calibration is of another sensor.
        WorkError: no press has a place and a force, or no frame is said to be in contact.
    """
    if calibration is not None:
        check_same_sensor(calibration, dataset)
    dataset, left_out = _in_proportion(dataset)
    session = gap_session(dataset)
    if not (session.press >= 0).any():
        check_phases(dataset, 1)
        raise refusal(
            dataset,
            "no press has a known place and a force: there is nothing to audit. Give x_m, y_m, z_m and force_n",
        )
    model = guessed_model(dataset, session) if calibration is None else calibrated_model(calibration, dataset)
    session = thinned(model, session)
    base = base_columns(model, session)
    slopes = hold_slopes(session, base, len(dataset.presses))
    floor = floor_of(dataset, slopes, rng, session.taxels)
    options = _options(dataset.meta.position.sigma_m, calibration)
    found = _report(model, session, base, floor, options, rng, calibration, planned=False)
    return replace(found, left_out=left_out)


def _in_proportion(dataset: Dataset) -> tuple[Dataset, tuple[int, ...]]:
    """The dataset without forces that are far above those of all others, and the numbers of presses that are such.

    One press of a ton would show any effect of the force, and would be all that the guessed scale is made of.
    """
    presses, frames = dataset.presses, dataset.frames
    known = presses.force_n[np.isfinite(presses.force_n) & (presses.force_n > 0)]
    if len(known) < FEWEST:
        return dataset, ()
    most_n = OUT_OF_PROPORTION * np.quantile(known, STRONG, method="lower")
    far = presses.force_n > most_n
    rest = replace(presses, force_n=np.where(far, np.nan, presses.force_n))
    if frames is not None:
        of_far = np.isin(frames.press, presses.press[far]) | (frames.force_n > most_n)
        frames = replace(frames, force_n=np.where(of_far, np.nan, frames.force_n))
    return replace(dataset, presses=rest, frames=frames), tuple(presses.press[far].tolist())


def audit_plan(
    plan: Plan, description: HandDescription, calibration: Calibration | None, rng: np.random.Generator
) -> AuditReport:
    """Audits a plan, with the noise of one count a frame that the simulated hand has.

    Args:
        plan: the presses.
        description: the hand that would press.
        calibration: gives pose, E and S; None: they are guessed.
        rng: for cases that vary from taxel to taxel.

    Raises:
        InputError: the plan's poses do not suit the hand, or the calibration is of another sensor.
    """
    meta, mount = description.meta, Mount.of(description.meta)
    readout = Readout(meta.sensor.value_min, meta.sensor.value_max, meta.sensor.integer)
    if calibration is None:
        model = BaseModel(
            mount.surface,
            mount.layout,
            mount.pose,
            GUESSED_PA_PER_M,
            GUESSED_PER_N,
            readout,
            resolution_of(mount.layout),
        )
    else:
        place = f"hand {description.name}"
        differ = sensor_differences(calibration, meta.sensor, mount.layout, meta.surface, {}, place=place)
        if differ:
            raise InputError(differ)
        own = calibration.parameters()
        model = BaseModel(
            calibration.surface_model(),
            calibration.layout(),
            calibration.pose(),
            own.elasticity_pa_per_m,
            own.scale_per_n,
            readout,
            resolution_of(calibration.layout()),
        )
    session = thinned(model, plan_session(plan, description))
    options = _options(meta.position.sigma_m, calibration)
    base = base_columns(model, session)
    return _report(model, session, base, assumed_floor(readout), options, rng, calibration, planned=True)


def _report(
    model: BaseModel,
    session: GapSession,
    base: BaseColumns,
    floor: NoiseFloor,
    options: AuditOptions,
    rng: np.random.Generator,
    calibration: Calibration | None,
    *,
    planned: bool,
) -> AuditReport:
    found = audit(linearise(model, session, base, floor, options, rng), options)
    facts = facts_of(session)
    reasons = {name: why_not(one, facts) for name, one in found.items() if not one.visible}
    if planned and "shear" in reasons:
        reasons["shear"] = "a plan does not say which tangential forces there will be"
    presses = len(np.unique(session.press[session.press >= 0]))
    return AuditReport(
        found,
        reasons,
        floor,
        presses,
        len(session),
        base.values.shape[1],
        session.has_frames,
        calibration is not None,
        planned,
        options,
    )


def _options(position_sigma_m: float, calibration: Calibration | None) -> AuditOptions:
    """What positions and forces are worth: what the fit found, else what the data say."""
    usual = AuditOptions()
    found: Mapping[str, Any] = {} if calibration is None else calibration.loss.extra
    return AuditOptions(
        position_sigma_m=_positive(found.get("position_sigma_m"), position_sigma_m),
        force_sigma=_positive(found.get("force_sigma_relative"), usual.force_sigma),
    )


def _positive(value: object, otherwise: float) -> float:
    return float(value) if isinstance(value, int | float) and 0 < value < np.inf else otherwise
