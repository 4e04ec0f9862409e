"""The audit of a dataset or of a plan: what its presses can show, what not, and why."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import ndtri

from skincal.calibration import Calibration, check_same_sensor, sensor_differences
from skincal.collect import Mount, Plan
from skincal.dataset import Dataset
from skincal.dataset.refusal import refusal
from skincal.diagnosis.dataset_session import gap_session
from skincal.diagnosis.observed import NoiseFloor, forward_of, observe
from skincal.diagnosis.phases import check_phases
from skincal.diagnosis.planned_session import plan_session
from skincal.diagnosis.reasons import EffectAudit, facts_of, why_not
from skincal.effects import COVARIATES, EFFECTS
from skincal.errors import InputError
from skincal.inference.candidate_scores import top_counts
from skincal.inference.constants import CONSTANTS as C
from skincal.inference.fit import Fitter, Priors
from skincal.inference.forward import LAW, State
from skincal.inference.noise import Noise
from skincal.inference.session import GapSession
from skincal.inference.slopes import Slopes
from skincal.model.arrays import FloatArray
from skincal.robot import HandDescription

STRONG, OUT_OF_PROPORTION, FEWEST = 0.9, 10.0, 5
"""A force is no measurement if it is so many times the one that so large a share of so many presses stays below."""
GUESSED_PA_PER_M, GUESSED_PER_N = 4.5e8, 70.0


@dataclass(frozen=True)
class AuditOptions:
    """What the audit counts with.

    Attributes:
        false_alarm: of the whole list of effects.
        power: at the smallest strength.
        alike: cosine above which two effects look the same.
        position_sigma_m: of the measured place of a press, along each direction [m].
        force_sigma: of the measured force of a press, relative.
        shape_sigma: doubt of each taxel's value in a press, relative and shared by its frames.
    """

    false_alarm: float = 0.05
    power: float = 0.9
    alike: float = 0.95
    position_sigma_m: float = 1e-3
    force_sigma: float = C.force
    shape_sigma: float = C.image


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
    seen = observe(dataset, calibration, rng, keep=False)
    found = report_of(
        seen.fitter,
        seen.fitter.priors.start,
        seen.floor,
        rng,
        calibrated=calibration is not None,
        planned=False,
    )
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
    """Audits a session that has not been recorded; arguments as of :func:`audit_plan`."""
    meta, mount = description.meta, Mount.of(description.meta)
    step = 1.0 if meta.sensor.integer else 0.0
    low = -np.inf if meta.sensor.value_min is None else meta.sensor.value_min
    high = np.inf if meta.sensor.value_max is None else meta.sensor.value_max
    taxels = mount.layout.taxels
    noise = Noise(np.ones(taxels), 0.0, step, low, high, 0.01, low if np.isfinite(low) else 0.0)
    forward = forward_of(session, mount.surface, mount.layout, noise, clipped=bool(np.isfinite(low)))
    own = None if calibration is None else calibration.parameters()
    e, scale = (
        (GUESSED_PA_PER_M, GUESSED_PER_N) if own is None else (own.elasticity_pa_per_m, own.scale_per_n)
    )
    pose = mount.pose if calibration is None else calibration.pose()
    rest = low if np.isfinite(low) else 0.0
    start = State(
        pose,
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
    return report_of(
        Fitter(forward, counts, before), start, floor, rng, calibrated=calibration is not None, planned=True
    )


def report_of(
    fitter: Fitter,
    state: State,
    floor: NoiseFloor,
    rng: np.random.Generator,
    *,
    calibrated: bool,
    planned: bool,
) -> AuditReport:
    """What presses can show of typical cases of every effect, by the information that the engine would have.

    Args:
        fitter: of the session.
        state: the sensor.
        floor: the noise in plain numbers.
        rng: for cases that vary from taxel to taxel.
        calibrated: whether the sensor is a calibration's.
        planned: whether there are no data yet.
    """
    f, session = fitter.forward, fitter.forward.session
    options = AuditOptions(position_sigma_m=float(1 / np.sqrt(fitter.priors.move[0])))
    seen = f.predict(state)
    samples = session.samples
    have = {c for c in COVARIATES if samples.has(c)}
    poses = 1 if samples.pose is None else int(samples.pose.max(initial=0)) + 1
    lacking = {n: tuple(c for c in e.covariates if c not in have) for n, e in EFFECTS.items()}
    names = [n for n in EFFECTS if not lacking[n]]
    top = top_counts(seen, samples)
    cases: list[FloatArray] = []
    for name in names:
        case = EFFECTS[name].at_strength(1.0, rng, f.layout, max(poses, 2), top_counts=top)
        if name in state.effects:
            cases.append(np.zeros_like(seen.values))
            continue
        cases.append(np.nan_to_num(f.with_effects(seen, {**state.effects, name: case}) - seen.values))
    w = fitter.whitened(
        seen,
        Slopes.joined([fitter.columns(seen, ()), Slopes.of(np.stack(cases, axis=-1))]),
        fitter.equation_errors(seen)[0],
    )
    h = fitter.linearised(seen, (), w, 0).blocks.h.sum(axis=0)
    n = h.shape[0] - len(names)
    raw = (w.columns.dense[..., n:] ** 2).sum(axis=(0, 1))
    base = h[:n, :n] + np.diag(fitter.prior(state, ())[0])
    left = h[n:, n:] - h[n:, :n] @ np.linalg.solve(base, h[:n, n:])
    square = np.maximum(np.diag(left), 0.0)
    needed = float(ndtri(options.power) - ndtri(options.false_alarm / (2 * len(EFFECTS))))
    cosine = np.abs(left) / np.sqrt(np.maximum(np.outer(square, square), 1e-12))
    effects: dict[str, EffectAudit] = {}
    for name in EFFECTS:
        if name not in names:
            effects[name] = EffectAudit(
                name, 0.0, 0.0, needed, float("inf"), 0.0, 0.0, lacking[name], {}, (name,)
            )
            continue
        k = names.index(name)
        d, whole = float(np.sqrt(square[k])), float(max(raw[k], 1e-12))
        overlaps = {other: float(min(cosine[k, j], 1.0)) for j, other in enumerate(names)} if d > 0 else {}
        alike = tuple(o for o, c in overlaps.items() if o != name and c > options.alike)
        smallest = needed / d if d > 1e-6 else float("inf")
        middle = float(h[n + k, n + k])
        effects[name] = EffectAudit(
            name,
            d,
            float(np.sqrt(whole)),
            needed,
            smallest,
            1 - middle / whole,
            (middle - square[k]) / whole,
            (),
            overlaps,
            (name, *alike),
        )
    facts = facts_of(session)
    reasons = {name: why_not(one, facts) for name, one in effects.items() if not one.visible}
    for name in reasons if planned else ():
        if effects[name].lacking == ("shear",):
            reasons[name] = "a plan does not say which tangential forces there will be"
    presses = len(np.unique(session.press[session.press >= 0]))
    taxels = seen.values.shape[1]
    return AuditReport(
        effects,
        reasons,
        floor,
        presses,
        len(session),
        taxels,
        session.has_frames,
        calibrated,
        planned,
        options,
    )
