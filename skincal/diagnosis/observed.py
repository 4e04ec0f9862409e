"""A dataset and a calibration as the engine takes them: samples, counts, noise, a start, and what is known of it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import radians

import numpy as np

from skincal.calibration import MARGIN_M, Calibration
from skincal.calibration.skin import effects_of
from skincal.dataset import IDLE, Dataset, idle_means
from skincal.dataset.refusal import refusal
from skincal.dataset.uniform_pressure import uniform_pressure, zero_load_levels
from skincal.diagnosis.dataset_session import gap_session, hold_groups, pose_names, press_rows
from skincal.diagnosis.phases import check_phases
from skincal.diagnosis.spells import Spell, without_spells
from skincal.effects import COVARIATES, EFFECTS
from skincal.errors import InputError, Problem
from skincal.fitting.observe import Readout, clipped_share, noise_from_rest
from skincal.inference.constants import CONSTANTS as C
from skincal.inference.contact_law import law_parameters
from skincal.inference.fit import Fitter, Priors
from skincal.inference.forward import LAW, Forward, State
from skincal.inference.noise import Noise, clipped_at_rest, noise_of
from skincal.inference.session import Binning, GapSession
from skincal.model import ContactLaw, Surface, TaxelLayout
from skincal.model.arrays import BoolArray, IntArray
from skincal.model.patch import Rule
from skincal.model.rest import rest_from_presses

LEAST_TO_DIAGNOSE = 12
"""Fewer cannot be fitted, choose and be kept for the end."""
_CELLS, _FINEST_M, _MARGIN_M, _STILL_M = 9000, 3.5e-4, 6e-3, 1e-9


@dataclass(frozen=True, eq=False)
class NoiseFloor:
    """The noise of a session in plain numbers [counts].

    Attributes:
        frame_counts: of a frame, before rounding and clipping.
        frame_interval: where that lies, 95 %.
        frame_from: where it was found.
        mean_counts: of a hold mean.
        mean_interval: where that lies.
        mean_from: where it was found.
        grows: part of the value that a frame's noise grows by.
        step_counts: of the converter.
        measured: whether anything in the data shows it.
    """

    frame_counts: float
    frame_interval: tuple[float, float]
    frame_from: str
    mean_counts: float
    mean_interval: tuple[float, float]
    mean_from: str
    grows: float = 0.0
    step_counts: float = 0.0
    measured: bool = True


@dataclass(frozen=True, eq=False)
class Observed:
    """What the engine works on.

    Attributes:
        dataset: as the user knows it.
        session: samples and observations.
        fitter: of the session, with the presses of the end kept from it.
        held: (P,) presses that are kept for the end.
        floor: the noise in plain numbers.
        covariates: that are there.
        poses: names of the hand poses by their numbers.
        taxels: (J,) which taxels are looked at; None for all.
        never: (J,) taxels of which nothing was read.
        spells: of taxels that step or stick, which are taken off.
    """

    dataset: Dataset
    session: GapSession
    fitter: Fitter
    held: BoolArray
    floor: NoiseFloor
    covariates: frozenset[str]
    poses: tuple[str, ...]
    never: BoolArray
    spells: tuple[Spell, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Effects whose covariates are there."""
        return tuple(e.name for e in EFFECTS.values() if set(e.covariates) <= self.covariates)

    def whole(self) -> Fitter:
        """The same with the presses of the end."""
        assert self.session.counts is not None
        return Fitter(self.fitter.forward, self.session.counts, self.fitter.priors)

    def without(self, spells: tuple[Spell, ...]) -> Observed:
        """The same with more spells taken off; nothing of what was found about them stays."""
        session, old = without_spells(self.session, spells), self.fitter
        f = old.forward
        assert session.counts is not None
        forward = forward_of(
            session, f.surface, f.layout, f.noise, clipped=f.rests_clipped, margin_m=margin_of(self.dataset)
        )
        shown = np.where(np.isfinite(old.counts), session.counts, np.nan)
        uniform = uniform_pressure(self.dataset)
        start, stuck = old.priors.start, [one.taxel for one in spells if one.stuck]
        if start.log_s.ndim:
            # A calibration that took what sticks for a reading says nothing of that taxel.
            log_s = start.log_s.copy()
            log_s[stuck] = np.median(log_s)
            start = replace(start, log_s=log_s)
        before = beforehand(self.dataset, start, 1.0, session, uniform=uniform)
        before = replace(before, base=old.priors.base)
        return replace(
            self, session=session, fitter=Fitter(forward, shown, before), spells=(*self.spells, *spells)
        )


def resolution_of(layout: TaxelLayout, surface: Surface) -> tuple[float, Rule]:
    """Longest edge of a cell of the patch [m], and where a point lies in it."""
    across, along = np.diff(layout.bounds_m, axis=0).ravel().tolist()
    fewest = (across * along / _CELLS) ** 0.5
    finest = max(_FINEST_M, min(fewest, float(layout.sizes_m.min()) / 4))
    return finest, "gauss" if surface.is_uniform else "midpoint"


def forward_of(
    session: GapSession,
    surface: Surface,
    layout: TaxelLayout,
    noise: Noise,
    *,
    clipped: bool,
    margin_m: float = _MARGIN_M,
) -> Forward:
    """The model of a session."""
    resolution, rule = resolution_of(layout, surface)
    return Forward(
        session,
        surface,
        layout,
        noise,
        clipped=clipped,
        resolution_m=resolution,
        margin_m=margin_m,
        rule=rule,
    )  # type: ignore[arg-type]


def margin_of(dataset: Dataset) -> float:
    """How far the modelled skin goes on around the taxels [m]: a chamber's forces are those of a calibration's skin."""
    return MARGIN_M if uniform_pressure(dataset) else _MARGIN_M


def observe(
    dataset: Dataset, calibration: Calibration | None, rng: np.random.Generator, *, keep: bool = True
) -> Observed:
    """Reads a session as the engine needs it.

    Args:
        dataset: the session.
        calibration: where to start, and effects that are known; None: from the nominal pose.
        rng: chooses the presses of the end.
        keep: whether some are kept for the end.

    Raises:
        WorkError: too few presses have a known place and a force.
        InputError: there is no position at all.
    """
    uniform = uniform_pressure(dataset)
    if not uniform and not np.isfinite(dataset.meta.position.sigma_m):
        place = "dataset.toml" if dataset.folder is None else str(dataset.folder / "dataset.toml")
        fix = "Only of uniform pressure, a flat punch larger than the patch, need no place be known."
        raise InputError([Problem(f"{place}: [position] sigma_m", "places that were measured", "inf", fix)])
    session = gap_session(dataset)
    pressed = np.unique(session.press[session.press >= 0])
    if len(pressed) < (LEAST_TO_DIAGNOSE if keep else 1):
        check_phases(dataset, LEAST_TO_DIAGNOSE)
        raise refusal(
            dataset,
            f"expected {LEAST_TO_DIAGNOSE} presses with a known place and a force at least, because some are fitted, "
            f"some choose and some are kept for the end; got {len(pressed)}. Record more presses",
        )
    noise, floor, rest_sigma, clipped, session = _noise(dataset, session, calibration)
    rest = noise.rest
    if uniform and dataset.frames is None:
        # No taxel is ever at rest: the level is where the lines of all taxels meet no load, as far as they agree.
        rest, rest_sigma = _rest_by_lines(dataset)
        clipped = False
    layout = dataset.layout()
    surface = dataset.surface()
    forward = forward_of(session, surface, layout, noise, clipped=clipped, margin_m=margin_of(dataset))
    start = start_state(dataset, calibration, session, rest, pose_names(dataset))
    before = beforehand(dataset, start, rest_sigma, session, uniform=uniform)
    counts = session.counts
    assert counts is not None
    held = _held(session, pressed, rng) if keep else np.zeros(session.presses, dtype=np.bool_)
    shown = np.where(((session.press >= 0) & held[np.maximum(session.press, 0)])[:, None], np.nan, counts)
    covariates = frozenset(c for c in COVARIATES if session.samples.has(c))
    never = np.asarray(~np.isfinite(counts).any(axis=0))
    return Observed(
        dataset, session, Fitter(forward, shown, before), held, floor, covariates, pose_names(dataset), never
    )


def _held(session: GapSession, pressed: IntArray, rng: np.random.Generator) -> BoolArray:
    held = np.zeros(session.presses, dtype=np.bool_)
    held[rng.choice(pressed, max(3, len(pressed) // 6), replace=False)] = True
    return held


def start_state(
    dataset: Dataset,
    calibration: Calibration | None,
    session: GapSession,
    rest: float,
    poses: tuple[str, ...],
) -> State:
    """Where the fit begins: a calibration's numbers, or the nominal pose and middling E and S."""
    moves = np.zeros((session.presses, 3))
    if calibration is None:
        return State(
            dataset.nominal_pose(),
            float(np.log(4.5e8)),
            np.asarray(np.log(_scale(session, rest))),
            rest,
            np.zeros(len(LAW)),
            moves,
        )
    own = calibration.parameters()
    # A taxel that does not answer has next to no scale.
    scale = np.asarray(own.scale_per_n)
    scale = np.maximum(scale, 1e-9 * scale.max())
    effects = {n: {k: np.asarray(v) for k, v in p.items()} for n, p in effects_of(calibration, poses).items()}
    law = ContactLaw() if calibration.contact_law is None else calibration.contact_law.law
    # Of a state E is that under the session's first ball.
    e = own.elasticity_pa_per_m * law.stiffness(session.samples.indenters[0])
    return State(
        calibration.pose(), float(np.log(e)), np.log(scale), rest, law_parameters(law), moves, effects
    )


def _scale(session: GapSession, rest: float) -> float:
    """S by the sum of an image over its force, for sensors whose taxels cover half of the patch."""
    assert session.counts is not None
    held = session.press >= 0
    own = session.mean_force()[held]
    lit = np.nansum(np.maximum(session.counts[held] - rest, 0.0), axis=1)
    ok = own > 0.5 * np.nanmax(own, initial=0.0)
    return float(np.clip(2.0 * np.median(lit[ok] / own[ok]), 1e-9, None)) if ok.any() else 60.0


def beforehand(
    dataset: Dataset, start: State, rest_sigma: float, session: GapSession, *, uniform: bool
) -> Priors:
    """What is known before the fit: ranges of the mount, what positions are worth, how well rest is known."""
    mount, position = dataset.meta.mount, dataset.meta.position

    def half(ends: tuple[float, float] | None, otherwise: float) -> float:
        return (
            otherwise
            if ends is None or not np.isfinite(ends[1] - ends[0]) or ends[1] <= ends[0]
            else (ends[1] - ends[0]) / 2
        )

    radius = dataset.surface().arc_radius_at(dataset.nominal_pose())
    turn = (
        half(mount.x_range_m, 4e-3) if radius is None else radians(half(mount.beta_range_deg, 12.0)) * radius
    )
    sigma = np.array(
        [
            half(mount.y_range_m, 4e-3),
            turn,
            radians(half(mount.alpha_range_deg, 20.0)),
            1.0,
            1.5,
            max(rest_sigma, 1e-9),
        ]
    )
    # Under a punch larger than the patch places do not matter: held still, all presses share one table.
    worth = _STILL_M if uniform else max(position.sigma_m, 1e-5)
    slack = _STILL_M if uniform else position.slack_m if np.isfinite(position.slack_m or np.inf) else 2e-3
    move = 1 / np.array([worth, worth, C.force]) ** 2
    assert session.counts is not None
    return Priors(1 / sigma**2, start, move, slack or 2e-3, np.ones(session.counts.shape))


def _noise(
    dataset: Dataset, session: GapSession, calibration: Calibration | None
) -> tuple[Noise, NoiseFloor, float, bool, GapSession]:
    """Noise, the same in words, how well the level at rest is known, whether it clips, and the session."""
    sensor = dataset.meta.sensor
    raw = sensor.baseline != "subtracted"
    low = sensor.value_min if raw and sensor.value_min is not None else -np.inf
    high = sensor.value_max if raw and sensor.value_max is not None else np.inf
    frames = dataset.frames
    assert session.counts is not None
    taxels = session.counts.shape[1]
    if frames is not None:
        rows = press_rows(dataset)
        idle = (frames.phase == IDLE) & (rows < 0)
        stretch = np.where(idle, np.cumsum(np.diff(idle.astype(int), prepend=0) != 0), -1)
        force = np.nan_to_num(frames.force_n)
        noise = noise_of(
            frames.counts, hold_groups(dataset), stretch, force, low, high, integer=sensor.integer
        )
        mean = idle_means(dataset)
        mean = rest_from_presses(dataset.presses.counts)[0] if mean is None else mean
        count = max(int((hold_groups(dataset) >= 0).sum()) * taxels, 1)
        found = "frames that follow each other"
    else:
        mean, scatter = rest_from_presses(dataset.presses.counts)
        if uniform_pressure(dataset):
            scatter = _scatter_of_neighbours(dataset)
        said = 0.0 if calibration is None else float(calibration.loss.extra.get("noise_sigma_counts") or 0.0)
        top = float(np.nanmax(dataset.presses.counts) - np.nanmedian(mean))
        own = scatter if np.isfinite(scatter) and scatter > 0 else said if said > 0 else 0.005 * top
        sigma = (
            noise_from_rest(float(np.nanmedian(mean)), _readout(low, high, sensor.integer))
            if np.isfinite(low) and not uniform_pressure(dataset)
            else float("nan")
        )
        step = 1.0 if sensor.integer and np.isfinite(sigma) else 0.0
        if not np.isfinite(sigma):
            sigma, low, high = own, -np.inf, np.inf
        else:
            # Clipped noise scatters less than it would elsewhere.
            own = own / clipped_share(low, sigma, _readout(low, high, sensor.integer))
        full = float(np.hypot(sigma, step / np.sqrt(12)))
        session = replace(session, frames=np.full(len(session), max(1.0, (full / max(own, 1e-12)) ** 2)))
        noise = Noise(np.full(taxels, max(sigma, C.least_noise * top)), 0.0, step, low, high)
        count, found = len(dataset.presses), "hold means of taxels that are not pressed"
        if uniform_pressure(dataset):
            found = "presses that follow each other, about a line in the force"
    middle = float(np.nanmedian(mean)) if np.isfinite(mean).any() else 0.0
    clipped = bool(np.isfinite(low)) and bool(clipped_at_rest(np.array(middle), low, noise.frame))
    noise = replace(noise, rest=middle)
    rest, within = (low, 0.0) if clipped else noise.level_of(middle, count)
    noise = replace(noise, rest=rest)
    per_mean = float(np.hypot(noise.frame, noise.step / np.sqrt(12)) / np.sqrt(_hold_frames(session)))
    width = 1.96 * float(np.hypot(1 / np.sqrt(2 * count), noise.within))
    floor = NoiseFloor(
        noise.frame, (noise.frame * (1 - width), noise.frame * (1 + width)), found,
        per_mean, (per_mean * (1 - width), per_mean * (1 + width)), found, noise.grows, noise.step,
    )  # fmt: skip
    return noise, floor, float(np.hypot(C.rest * noise.frame, within)), clipped, session


def _scatter_of_neighbours(dataset: Dataset) -> float:
    """Scatter of a hold mean about the line between the presses before and after it, robust over all taxels."""
    counts, force = dataset.presses.counts, dataset.presses.force_n
    first, last = force[:-2], force[2:]
    inside = (np.minimum(first, last) < force[1:-1]) & (force[1:-1] < np.maximum(first, last))
    part = np.where(inside, (force[1:-1] - first) / np.where(inside, last - first, 1.0), np.nan)[:, None]
    off = counts[1:-1] - (1 - part) * counts[:-2] - part * counts[2:]
    each = off / np.sqrt(1 + part**2 + (1 - part) ** 2)
    known = np.abs(each[np.isfinite(each)])
    return 1.4826 * float(np.median(known)) if len(known) else float("nan")


def _rest_by_lines(dataset: Dataset) -> tuple[float, float]:
    """Level at rest by the lines of all taxels, and how far these differ [counts]."""
    levels = zero_load_levels(dataset)
    ends = levels[np.isfinite(levels)]
    return float(np.median(ends)), float(np.ptp(np.quantile(ends, [0.16, 0.84])) / 2)


def _hold_frames(session: GapSession) -> float:
    own = session.held()
    count = np.bincount(session.press[own], session.frames[own]) if own.any() else session.frames
    return float(np.median(count[count > 0])) if (count > 0).any() else 1.0


def _readout(low: float, high: float, integer: bool) -> Readout:
    return Readout(low if np.isfinite(low) else None, high if np.isfinite(high) else None, integer)


def full_rate(observed: Observed) -> Forward:
    """The model of every single frame, for the gap; of hold means where there are no frames."""
    dataset, forward = observed.dataset, observed.fitter.forward
    if dataset.frames is None:
        return forward
    session = without_spells(gap_session(dataset, Binning(*[len(dataset.frames)] * 4)), observed.spells)
    return forward_of(
        session,
        forward.surface,
        forward.layout,
        forward.noise,
        clipped=forward.rests_clipped,
        margin_m=margin_of(dataset),
    )
