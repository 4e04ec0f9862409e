"""Audit a dataset or a plan: which effects its presses can show, which not, and why."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import ndtri

from skincal.calibration import Calibration, check_same_sensor, sensor_differences
from skincal.collect import Mount, Plan
from skincal.dataset import Dataset
from skincal.dataset.dataset import refusal
from skincal.diagnosis.dataset_session import check_phases, gap_session
from skincal.diagnosis.invisible_effects import EffectAudit, explain_invisibility, summarize_presses
from skincal.diagnosis.observed import GUESSED_PA_PER_M, NoiseFloor, build_forward, observe
from skincal.diagnosis.planned_session import plan_session
from skincal.effects import COVARIATES, EFFECTS
from skincal.errors import InputError
from skincal.inference.candidate_scores import top_counts
from skincal.inference.constants import CONSTANTS as C
from skincal.inference.fit import Fitter, Priors
from skincal.inference.forward import LAW, Forward, State, StatePrediction
from skincal.inference.noise import Noise
from skincal.inference.session import GapSession
from skincal.inference.slopes import Slopes
from skincal.model.arrays import FloatArray
from skincal.robot import HandDescription

FORCE_QUANTILE, FORCE_RATIO, FEWEST_FORCES = 0.9, 10.0, 5
"""A force is an outlier above this multiple of this quantile of all forces, if there are so many. Set by eye."""
GUESSED_PER_N = 70.0
"""S that is assumed for a plan without a calibration."""


@dataclass(frozen=True)
class AuditOptions:
    """Assumptions of the audit.

    Attributes:
        false_alarm: false alarm rate over all effects.
        power: probability of detection at the smallest strength.
        alike: cosine above which two effects cannot be distinguished.
        position_sigma_m: standard deviation of a measured contact position along each direction [m].
        force_sigma: relative standard deviation of a measured force.
        shape_sigma: relative image error of each taxel in a press, shared by the frames of the press.
    """

    false_alarm: float = 0.05
    power: float = 0.9
    alike: float = 0.95
    position_sigma_m: float = 1e-3
    force_sigma: float = C.force
    shape_sigma: float = C.image


@dataclass(frozen=True, eq=False)
class AuditReport:
    """The effects that a session can show.

    Attributes:
        effects: audit of each effect, in the order of the chain.
        reasons: why an effect is not visible, by name.
        floor: noise floor.
        presses: number of presses.
        observations: number of images used, each the mean of a few frames.
        taxels: number of taxels.
        has_frames: whether the images are of frames, not of hold means.
        calibrated: whether pose, E and S are those of a calibration, not guessed.
        planned: whether there are no data yet, and the noise is assumed.
        options: false alarm rate, power, and uncertainty of positions and forces.
        left_out: numbers of presses left out because their force is an outlier.
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
        """Effects of which a typical case is visible."""
        return tuple(name for name, effect in self.effects.items() if effect.visible)

    @property
    def cannot_see(self) -> tuple[str, ...]:
        """Effects of which a typical case is not visible."""
        return tuple(name for name, effect in self.effects.items() if not effect.visible)

    @property
    def rows(self) -> list[dict[str, Any]]:
        """The audit of each effect as plain values; an infinite strength is None."""
        return [
            {
                "name": name,
                "visible": effect.visible,
                "distance": effect.distance,
                "smallest_strength": effect.smallest_strength
                if np.isfinite(effect.smallest_strength)
                else None,
                "consistent_with": list(effect.consistent_with),
                "lacking": list(effect.lacking),
                "reason": self.reasons.get(name),
            }
            for name, effect in self.effects.items()
        ]


def audit_dataset(dataset: Dataset, calibration: Calibration | None, rng: np.random.Generator) -> AuditReport:
    """Audit a dataset.

    Args:
        dataset: the dataset.
        calibration: gives pose, E and S; None: they are guessed.
        rng: draws the typical cases that vary from taxel to taxel.

    Raises:
        InputError: the calibration is of another sensor.
        WorkError: no press has a position and a force, or no frame is in contact.
    """
    if calibration is not None:
        check_same_sensor(calibration, dataset)
    dataset, left_out = _drop_force_outliers(dataset)
    session = gap_session(dataset)
    if not (session.press >= 0).any():
        check_phases(dataset, 1)
        raise refusal(
            dataset,
            "no press has a known place and a force: there is nothing to audit. Give x_m, y_m, z_m and force_n",
        )
    observed = observe(dataset, calibration, rng, keep=False)
    report = audit_session(
        observed.fitter,
        observed.fitter.priors.start,
        observed.floor,
        rng,
        state_is_calibrated=calibration is not None,
        planned=False,
    )
    return replace(report, left_out=left_out)


def _drop_force_outliers(dataset: Dataset) -> tuple[Dataset, tuple[int, ...]]:
    """Return the dataset with outliers of the force set to NaN, and the numbers of these presses.

    A single press with a hundred times the force of the others would make every effect of the force seem visible, and
    would determine the guessed scale alone.
    """
    presses, frames = dataset.presses, dataset.frames
    known = presses.force_n[np.isfinite(presses.force_n) & (presses.force_n > 0)]
    if len(known) < FEWEST_FORCES:
        return dataset, ()
    most_n = FORCE_RATIO * np.quantile(known, FORCE_QUANTILE, method="lower")
    is_outlier = presses.force_n > most_n
    kept = replace(presses, force_n=np.where(is_outlier, np.nan, presses.force_n))
    if frames is not None:
        dropped = np.isin(frames.press, presses.press[is_outlier]) | (frames.force_n > most_n)
        frames = replace(frames, force_n=np.where(dropped, np.nan, frames.force_n))
    return replace(dataset, presses=kept, frames=frames), tuple(presses.press[is_outlier].tolist())


def audit_plan(
    plan: Plan, description: HandDescription, calibration: Calibration | None, rng: np.random.Generator
) -> AuditReport:
    """Audit a plan, with the noise of the simulated hand: one count in each frame.

    Args:
        plan: the presses.
        description: the hand that would press.
        calibration: gives pose, E and S; None: they are guessed.
        rng: draws the typical cases that vary from taxel to taxel.

    Raises:
        InputError: the plan's poses do not suit the hand, or the calibration is of another sensor.
    """
    meta, mount = description.meta, Mount.of(description.meta)
    if calibration is not None:
        place = f"hand {description.name}"
        differ = sensor_differences(calibration, meta.sensor, mount.layout, meta.surface, {}, place=place)
        if differ:
            raise InputError(differ)
    return audit_planned(plan_session(plan, description), description, calibration, rng)


def audit_planned(
    session: GapSession,
    description: HandDescription,
    calibration: Calibration | None,
    rng: np.random.Generator,
) -> AuditReport:
    """Audit a session that has not been recorded; arguments as of :func:`audit_plan`."""
    meta, mount = description.meta, Mount.of(description.meta)
    step = 1.0 if meta.sensor.integer else 0.0
    low = -np.inf if meta.sensor.value_min is None else meta.sensor.value_min
    high = np.inf if meta.sensor.value_max is None else meta.sensor.value_max
    is_clipped, taxels = bool(np.isfinite(low)), mount.layout.taxels
    rest = low if is_clipped else 0.0
    noise = Noise(np.ones(taxels), 0.0, step, low, high, 0.01, rest)
    forward = build_forward(session, mount.surface, mount.layout, noise, clipped=is_clipped)
    own = None if calibration is None else calibration.parameters()
    e, scale = (
        (GUESSED_PA_PER_M, GUESSED_PER_N) if own is None else (own.elasticity_pa_per_m, own.scale_per_n)
    )
    start = State(
        mount.pose if calibration is None else calibration.pose(),
        float(np.log(e)),
        np.log(np.asarray(scale, dtype=np.float64)),
        rest,
        np.zeros(len(LAW)),
        np.zeros((session.presses, 3)),
    )
    counts = np.zeros((len(session), taxels))
    base = 1 / np.array([4e-3, 2e-3, 0.35, 1.0, 1.5, C.rest]) ** 2
    move = 1 / np.array([meta.position.sigma_m, meta.position.sigma_m, C.force]) ** 2
    before = Priors(base, start, move, 2e-3, np.ones_like(counts))
    mean = float(np.hypot(1.0, step / np.sqrt(12)) / 5)
    floor = NoiseFloor(
        1.0, (0.5, 2.0), "assumed", mean, (mean / 2, 2 * mean), "assumed", 0.0, step, measured=False
    )
    return audit_session(
        Fitter(forward, counts, before),
        start,
        floor,
        rng,
        state_is_calibrated=calibration is not None,
        planned=True,
    )


def audit_session(
    fitter: Fitter,
    state: State,
    floor: NoiseFloor,
    rng: np.random.Generator,
    *,
    state_is_calibrated: bool,
    planned: bool,
) -> AuditReport:
    """Audit a session by the Fisher information of a typical case of each effect, nuisance parameters eliminated.

    Args:
        fitter: fitter of the session.
        state: state of the sensor.
        floor: noise floor.
        rng: draws the typical cases that vary from taxel to taxel.
        state_is_calibrated: whether the state is that of a calibration.
        planned: whether there are no data yet.
    """
    forward, session = fitter.forward, fitter.forward.session
    options = AuditOptions(position_sigma_m=float(1 / np.sqrt(fitter.priors.move[0])))
    recorded = {c for c in COVARIATES if session.samples.has(c)}
    lacking = {n: tuple(c for c in e.covariates if c not in recorded) for n, e in EFFECTS.items()}
    names = [n for n in EFFECTS if not lacking[n]]
    seen = forward.predict(state)
    changes = _typical_changes(names, forward, seen, state, rng)
    whitened = fitter.whitened(
        seen, Slopes.joined([fitter.columns(seen, ()), Slopes.of(changes)]), fitter.equation_errors(seen)[0]
    )
    # Information matrix of base parameters and effects, the numbers of each press eliminated ...
    h = fitter.linearised(seen, (), whitened, 0).blocks.h.sum(axis=0)
    n = h.shape[0] - len(names)
    raw = (whitened.columns.dense[..., n:] ** 2).sum(axis=(0, 1))
    # ... and its Schur complement, the base parameters eliminated as well.
    base = h[:n, :n] + np.diag(fitter.prior(state, ())[0])
    schur = h[n:, n:] - h[n:, :n] @ np.linalg.solve(base, h[:n, n:])
    square = np.maximum(np.diag(schur), 0.0)
    threshold = float(ndtri(options.power) - ndtri(options.false_alarm / (2 * len(EFFECTS))))
    cosine = np.abs(schur) / np.sqrt(np.maximum(np.outer(square, square), 1e-12))
    effects: dict[str, EffectAudit] = {}
    for name in EFFECTS:
        if name not in names:
            effects[name] = EffectAudit(
                name, 0.0, 0.0, threshold, float("inf"), 0.0, 0.0, lacking[name], {}, (name,)
            )
            continue
        k = names.index(name)
        distance, total = float(np.sqrt(square[k])), float(max(raw[k], 1e-12))
        overlaps = (
            {other: float(min(cosine[k, j], 1.0)) for j, other in enumerate(names)} if distance > 0 else {}
        )
        alike = tuple(o for o, c in overlaps.items() if o != name and c > options.alike)
        without_presses = float(h[n + k, n + k])
        effects[name] = EffectAudit(
            name, distance, float(np.sqrt(total)), threshold,
            threshold / distance if distance > 1e-6 else float("inf"), 1 - without_presses / total,
            (without_presses - square[k]) / total, (), overlaps, (name, *alike),
        )  # fmt: skip
    variety = summarize_presses(session)
    reasons = {name: explain_invisibility(e, variety) for name, e in effects.items() if not e.visible}
    for name in reasons if planned else ():
        unplanned = [COVARIATES[lack].unplanned for lack in effects[name].lacking]
        if unplanned and all(unplanned):
            reasons[name] = f"a plan does not say {' and '.join(unplanned)}"
    return AuditReport(
        effects, reasons, floor, len(np.unique(session.press[session.press >= 0])), len(session),
        seen.values.shape[1], session.has_frames, state_is_calibrated, planned, options,
    )  # fmt: skip


def _typical_changes(
    names: Sequence[str], forward: Forward, seen: StatePrediction, state: State, rng: np.random.Generator
) -> FloatArray:
    """Return the changes (K, J, E) of values [counts] by a typical case of each effect; 0 for those in the state."""
    samples = forward.session.samples
    poses = 1 if samples.pose is None else int(samples.pose.max(initial=0)) + 1
    top = top_counts(seen, samples)
    changes: list[FloatArray] = []
    for name in names:
        case = EFFECTS[name].at_strength(1.0, rng, forward.layout, max(poses, 2), top_counts=top)
        if name in state.effects:
            changes.append(np.zeros_like(seen.values))
        else:
            changes.append(
                np.nan_to_num(forward.with_effects(seen, {**state.effects, name: case}) - seen.values)
            )
    return np.stack(changes, axis=-1)
