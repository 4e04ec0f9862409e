"""Prepare a dataset and a calibration for the inference: samples, counts, noise, initial state and prior."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import radians

import numpy as np

from skincal.calibration import MARGIN_M, Calibration
from skincal.calibration.calibration import effects_of
from skincal.dataset import IDLE, Dataset, idle_means
from skincal.dataset.dataset import refusal
from skincal.dataset.uniform_pressure import uniform_pressure, zero_load_levels
from skincal.diagnosis.dataset_session import check_phases, gap_session, hold_groups, pose_names, press_rows
from skincal.diagnosis.taxel_faults import TaxelFault, remove_faults
from skincal.effects import COVARIATES, EFFECTS
from skincal.errors import InputError, Problem
from skincal.fitting.observe import Readout, clipped_share, noise_from_rest
from skincal.inference.constants import CONSTANTS as C
from skincal.inference.contact_law import law_parameters
from skincal.inference.fit import Fitter, Priors
from skincal.inference.forward import LAW, Forward, State
from skincal.inference.noise import Noise, clipped_at_rest, noise_of
from skincal.inference.session import Binning, GapSession
from skincal.inference.start import session_as_shown
from skincal.model import ContactLaw, Surface, TaxelLayout
from skincal.model.arrays import BoolArray, FloatArray
from skincal.model.patch import Rule
from skincal.model.rest import rest_from_presses

LEAST_TO_DIAGNOSE = 12
"""Fewest presses that can be divided into training, selection and test presses."""
_CELLS, _FINEST_M = 9000, 3.5e-4
"""Largest number of cells of the patch, and smallest edge of a cell [m]: numerical resolution."""
_MARGIN_M = 6e-3
"""Width of the modelled skin around the taxels [m]."""
_FIXED_M = 1e-9
"""Standard deviation and slack of positions that are held fixed [m]."""
GUESSED_PA_PER_M, _GUESSED_PER_N = 4.5e8, 60.0
"""Initial guesses of E and S without a calibration."""


@dataclass(frozen=True, eq=False)
class NoiseFloor:
    """Standard deviation of the noise of a session [counts].

    Attributes:
        frame_counts: noise of a frame, before rounding and clipping.
        frame_interval: its 95 % interval.
        frame_from: data it was estimated from.
        mean_counts: noise of a hold mean.
        mean_interval: its 95 % interval.
        mean_from: data it was estimated from.
        grows: noise of a frame that is proportional to the signal, as a fraction of it.
        step_counts: step of the converter.
        measured: whether it was estimated from data, not assumed.
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
    """A dataset with the objects that the inference works on.

    Attributes:
        dataset: the dataset.
        session: samples and observations.
        fitter: fitter of the session without the test presses.
        is_test: (P,) whether a press is a test press.
        floor: noise floor.
        covariates: covariates that were recorded.
        poses: names of the hand poses, by their numbers.
        is_never_read: (J,) whether a taxel was never read.
        faults: temporary faults of taxels that were removed.
    """

    dataset: Dataset
    session: GapSession
    fitter: Fitter
    is_test: BoolArray
    floor: NoiseFloor
    covariates: frozenset[str]
    poses: tuple[str, ...]
    is_never_read: BoolArray
    faults: tuple[TaxelFault, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Effects whose covariates were recorded."""
        return tuple(e.name for e in EFFECTS.values() if set(e.covariates) <= self.covariates)

    def forward_of(self, session: GapSession) -> Forward:
        """Return the forward model of another session of the same skin, with the same noise."""
        f = self.fitter.forward
        margin_m = skin_margin_m(self.dataset)
        return build_forward(
            session, f.surface, f.layout, f.noise, clipped=f.rests_clipped, margin_m=margin_m
        )

    def fitter_of_all(self) -> Fitter:
        """Return the fitter of all presses, test presses included."""
        assert self.session.counts is not None
        return Fitter(self.fitter.forward, self.session.counts, self.fitter.priors)

    def without(self, faults: tuple[TaxelFault, ...]) -> Observed:
        """Return the session with further faults removed and robust weights reset to 1."""
        session, old = remove_faults(self.session, faults), self.fitter
        assert session.counts is not None
        counts = np.where(np.isfinite(old.counts), session.counts, np.nan)
        start, stuck = old.priors.start, [fault.taxel for fault in faults if fault.stuck]
        if start.log_s.ndim:
            # If the calibration took the stuck value for a reading, its scale of that taxel is meaningless.
            log_s = start.log_s.copy()
            log_s[stuck] = np.median(log_s)
            start = replace(start, log_s=log_s)
        before = build_prior(self.dataset, start, 1.0, session, uniform=uniform_pressure(self.dataset))
        before = replace(before, base=old.priors.base)
        return replace(
            self,
            session=session,
            fitter=Fitter(self.forward_of(session), counts, before),
            faults=(*self.faults, *faults),
        )


def mesh_resolution(layout: TaxelLayout, surface: Surface) -> tuple[float, Rule]:
    """Return the largest edge of a cell of the patch [m], and the quadrature rule within a cell."""
    across, along = np.diff(layout.bounds_m, axis=0).ravel().tolist()
    by_count = (across * along / _CELLS) ** 0.5
    edge = max(_FINEST_M, min(by_count, float(layout.sizes_m.min()) / 4))
    return edge, "gauss" if surface.is_uniform else "midpoint"


def build_forward(
    session: GapSession,
    surface: Surface,
    layout: TaxelLayout,
    noise: Noise,
    *,
    clipped: bool,
    margin_m: float = _MARGIN_M,
) -> Forward:
    """Return the forward model of a session."""
    resolution, rule = mesh_resolution(layout, surface)
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


def skin_margin_m(dataset: Dataset) -> float:
    """Return the width of the modelled skin around the taxels [m]; for a chamber it is that of its calibration."""
    return MARGIN_M if uniform_pressure(dataset) else _MARGIN_M


def observe(
    dataset: Dataset, calibration: Calibration | None, rng: np.random.Generator, *, keep: bool = True
) -> Observed:
    """Prepare a dataset for the inference.

    Args:
        dataset: the dataset.
        calibration: gives the initial state and known effects; None: start from the nominal pose.
        rng: chooses the test presses.
        keep: whether to reserve test presses.

    Raises:
        WorkError: too few presses have a known position and force.
        InputError: no position is known.
    """
    uniform = uniform_pressure(dataset)
    if not uniform and not np.isfinite(dataset.meta.position.sigma_m):
        place = "dataset.toml" if dataset.folder is None else str(dataset.folder / "dataset.toml")
        fix = "Positions may be unknown only for uniform pressure, or a flat punch larger than the patch."
        raise InputError([Problem(f"{place}: [position] sigma_m", "places that were measured", "inf", fix)])
    session = gap_session(dataset)
    pressed = np.unique(session.press[session.press >= 0])
    if len(pressed) < (LEAST_TO_DIAGNOSE if keep else 1):
        check_phases(dataset, LEAST_TO_DIAGNOSE)
        raise refusal(
            dataset,
            f"expected at least {LEAST_TO_DIAGNOSE} presses with a known place and a force, because they are divided "
            f"into presses for fitting, for selection and for the final test; got {len(pressed)}. Record more presses",
        )
    noise, floor, rest_sigma, clipped, session = _estimate_noise(dataset, session, calibration)
    rest = noise.rest
    if uniform and dataset.frames is None:
        # No taxel is ever at rest: extrapolate the line of each taxel to zero force.
        rest, rest_sigma = _rest_by_lines(dataset)
        clipped = False
    layout, surface = dataset.layout(), dataset.surface()

    def model(other: GapSession) -> Forward:
        return build_forward(other, surface, layout, noise, clipped=clipped, margin_m=skin_margin_m(dataset))

    forward = model(session)
    start = initial_state(dataset, calibration, session, rest, pose_names(dataset))
    before = build_prior(dataset, start, rest_sigma, session, uniform=uniform)
    assert session.counts is not None
    session = session_as_shown(Fitter(forward, session.counts, before), model)
    forward = model(session) if session is not forward.session else forward
    counts = session.counts
    assert counts is not None
    is_test = np.zeros(session.presses, dtype=np.bool_)
    if keep:
        is_test[rng.choice(pressed, max(3, len(pressed) // 6), replace=False)] = True
    of_test = (session.press >= 0) & is_test[np.maximum(session.press, 0)]
    return Observed(
        dataset,
        session,
        Fitter(forward, np.where(of_test[:, None], np.nan, counts), before),
        is_test,
        floor,
        frozenset(c for c in COVARIATES if session.samples.has(c)),
        pose_names(dataset),
        np.asarray(~np.isfinite(counts).any(axis=0)),
    )


def initial_state(
    dataset: Dataset,
    calibration: Calibration | None,
    session: GapSession,
    rest: float,
    poses: tuple[str, ...],
) -> State:
    """Return the initial state of a fit: that of a calibration, or the nominal pose with guessed E and S."""
    moves = np.zeros((session.presses, 3))
    if calibration is None:
        return State(
            dataset.nominal_pose(),
            float(np.log(GUESSED_PA_PER_M)),
            np.asarray(np.log(_guess_scale_per_n(session, rest))),
            rest,
            np.zeros(len(LAW)),
            moves,
        )
    own = calibration.parameters()
    # The logarithm of a scale of 0 (a dead taxel) must be finite.
    scale = np.asarray(own.scale_per_n)
    scale = np.maximum(scale, 1e-9 * scale.max())
    effects = {n: {k: np.asarray(v) for k, v in p.items()} for n, p in effects_of(calibration, poses).items()}
    law = ContactLaw() if calibration.contact_law is None else calibration.contact_law.law
    # E of a state is that under the first indenter of the session.
    e = own.elasticity_pa_per_m * law.stiffness(session.samples.indenters[0])
    return State(
        calibration.pose(), float(np.log(e)), np.log(scale), rest, law_parameters(law), moves, effects
    )


def _guess_scale_per_n(session: GapSession, rest: float) -> float:
    """Return twice the median of image sum over force: S of a sensor whose taxels cover half of the patch."""
    assert session.counts is not None
    is_pressed = session.press >= 0
    force = session.mean_force()[is_pressed]
    image_sum = np.nansum(np.maximum(session.counts[is_pressed] - rest, 0.0), axis=1)
    ok = force > 0.5 * np.nanmax(force, initial=0.0)
    ratio = image_sum[ok] / force[ok]
    return float(np.clip(2.0 * np.median(ratio), 1e-9, None)) if ok.any() else _GUESSED_PER_N


def build_prior(
    dataset: Dataset, start: State, rest_sigma: float, session: GapSession, *, uniform: bool
) -> Priors:
    """Return the prior of a fit: ranges of the mount, uncertainty of positions and forces, and of the rest level.

    Args:
        dataset: gives the ranges of the mount and the uncertainty of positions.
        start: mean of the prior.
        rest_sigma: standard deviation of the level at rest [counts].
        session: gives the shape of the weights.
        uniform: whether the pressure is uniform, so that positions are held fixed.
    """
    mount, position = dataset.meta.mount, dataset.meta.position

    def half_width(ends: tuple[float, float] | None, default: float) -> float:
        is_known = ends is not None and np.isfinite(ends[1] - ends[0]) and ends[1] > ends[0]
        return (ends[1] - ends[0]) / 2 if ends is not None and is_known else default

    radius = dataset.surface().arc_radius_at(dataset.nominal_pose())
    along = (
        half_width(mount.x_range_m, 4e-3)
        if radius is None
        else radians(half_width(mount.beta_range_deg, 12.0)) * radius
    )
    sigma = np.array(
        [
            half_width(mount.y_range_m, 4e-3),
            along,
            radians(half_width(mount.alpha_range_deg, 20.0)),
            1.0,
            1.5,
            max(rest_sigma, 1e-9),
        ]
    )
    # Under uniform pressure positions do not matter: with fixed positions, all presses share one table.
    position_sigma = _FIXED_M if uniform else max(position.sigma_m, 1e-5)
    slack = _FIXED_M if uniform else position.slack_m if np.isfinite(position.slack_m or np.inf) else 2e-3
    move = 1 / np.array([position_sigma, position_sigma, C.force]) ** 2
    assert session.counts is not None
    return Priors(1 / sigma**2, start, move, slack or 2e-3, np.ones(session.counts.shape))


def _estimate_noise(
    dataset: Dataset, session: GapSession, calibration: Calibration | None
) -> tuple[Noise, NoiseFloor, float, bool, GapSession]:
    """Estimate the noise of a session.

    Returns:
        The noise model; the noise floor; the standard deviation of the level at rest [counts]; whether the converter
        clips the level at rest; and the session, with the number of frames per hold mean if there are no frames.
    """
    sensor = dataset.meta.sensor
    raw = sensor.baseline != "subtracted"
    low = sensor.value_min if raw and sensor.value_min is not None else -np.inf
    high = sensor.value_max if raw and sensor.value_max is not None else np.inf
    if dataset.frames is not None:
        noise, mean, count = _noise_from_frames(dataset, low, high)
        source = "consecutive frames"
    else:
        noise, mean, session = _noise_from_holds(dataset, session, calibration, low, high)
        low, count = noise.low, len(dataset.presses)
        source = (
            "consecutive presses, about a line in the force"
            if uniform_pressure(dataset)
            else "hold means of unpressed taxels"
        )
    middle = float(np.nanmedian(mean)) if np.isfinite(mean).any() else 0.0
    clipped = bool(np.isfinite(low)) and bool(clipped_at_rest(np.array(middle), low, noise.frame))
    noise = replace(noise, rest=middle)
    rest, within = (low, 0.0) if clipped else noise.level_of(middle, count)
    noise = replace(noise, rest=rest)
    per_mean = float(np.hypot(noise.frame, noise.step / np.sqrt(12)) / np.sqrt(_frames_per_hold(session)))
    width = 1.96 * float(np.hypot(1 / np.sqrt(2 * count), noise.within))
    floor = NoiseFloor(
        noise.frame, (noise.frame * (1 - width), noise.frame * (1 + width)), source,
        per_mean, (per_mean * (1 - width), per_mean * (1 + width)), source, noise.grows, noise.step,
    )  # fmt: skip
    return noise, floor, float(np.hypot(C.rest * noise.frame, within)), clipped, session


def _noise_from_frames(dataset: Dataset, low: float, high: float) -> tuple[Noise, FloatArray, int]:
    """Return the noise, the mean at rest (J,) [counts], and the number of values in holds."""
    frames = dataset.frames
    assert frames is not None
    idle = (frames.phase == IDLE) & (press_rows(dataset) < 0)
    stretch = np.where(idle, np.cumsum(np.diff(idle.astype(int), prepend=0) != 0), -1)
    holds = hold_groups(dataset)
    integer, force = dataset.meta.sensor.integer, np.nan_to_num(frames.force_n)
    noise = noise_of(frames.counts, holds, stretch, force, low, high, integer=integer)
    mean = idle_means(dataset)
    mean = rest_from_presses(dataset.presses.counts)[0] if mean is None else mean
    return noise, mean, max(int((holds >= 0).sum()) * frames.counts.shape[1], 1)


def _noise_from_holds(
    dataset: Dataset, session: GapSession, calibration: Calibration | None, low: float, high: float
) -> tuple[Noise, FloatArray, GapSession]:
    """Return the noise and the mean at rest (J,) [counts] from hold means, and the session with frames per mean.

    The noise of one frame follows from how far clipping lifts the mean at rest, where the level is clipped. Otherwise
    each hold mean counts as one frame.
    """
    assert session.counts is not None
    counts, is_uniform = dataset.presses.counts, uniform_pressure(dataset)
    readout = _readout(low, high, dataset.meta.sensor.integer)
    mean, scatter = rest_from_presses(counts)
    if is_uniform:
        scatter = _scatter_of_neighbours(dataset)
    stated = 0.0 if calibration is None else float(calibration.loss.extra.get("noise_sigma_counts") or 0.0)
    top = float(np.nanmax(counts) - np.nanmedian(mean))
    mean_sigma = scatter if np.isfinite(scatter) and scatter > 0 else stated if stated > 0 else 0.005 * top
    sigma = (
        noise_from_rest(float(np.nanmedian(mean)), readout)
        if np.isfinite(low) and not is_uniform
        else float("nan")
    )
    step = 0.0
    if np.isfinite(sigma):
        step = 1.0 if dataset.meta.sensor.integer else 0.0
        # Clipping reduces the scatter at rest.
        mean_sigma = mean_sigma / clipped_share(low, sigma, readout)
    else:
        sigma, low, high = mean_sigma, -np.inf, np.inf
    frame_sigma = float(np.hypot(sigma, step / np.sqrt(12)))
    frames = np.full(len(session), max(1.0, (frame_sigma / max(mean_sigma, 1e-12)) ** 2))
    taxels = session.counts.shape[1]
    noise = Noise(np.full(taxels, max(sigma, C.least_noise * top)), 0.0, step, low, high)
    return noise, mean, replace(session, frames=frames)


def _scatter_of_neighbours(dataset: Dataset) -> float:
    """Return the robust scatter [counts] of hold means about the line between the presses before and after."""
    counts, force = dataset.presses.counts, dataset.presses.force_n
    first, last = force[:-2], force[2:]
    inside = (np.minimum(first, last) < force[1:-1]) & (force[1:-1] < np.maximum(first, last))
    part = np.where(inside, (force[1:-1] - first) / np.where(inside, last - first, 1.0), np.nan)[:, None]
    off = counts[1:-1] - (1 - part) * counts[:-2] - part * counts[2:]
    scaled = off / np.sqrt(1 + part**2 + (1 - part) ** 2)
    known = np.abs(scaled[np.isfinite(scaled)])
    return 1.4826 * float(np.median(known)) if len(known) else float("nan")


def _rest_by_lines(dataset: Dataset) -> tuple[float, float]:
    """Return the median level at rest of the lines of all taxels, and its spread between taxels [counts]."""
    levels = zero_load_levels(dataset)
    levels = levels[np.isfinite(levels)]
    return float(np.median(levels)), float(np.ptp(np.quantile(levels, [0.16, 0.84])) / 2)


def _frames_per_hold(session: GapSession) -> float:
    """Return the median number of frames of a hold."""
    own = session.held()
    count = np.bincount(session.press[own], session.frames[own]) if own.any() else session.frames
    return float(np.median(count[count > 0])) if (count > 0).any() else 1.0


def _readout(low: float, high: float, integer: bool) -> Readout:
    return Readout(low if np.isfinite(low) else None, high if np.isfinite(high) else None, integer)


def frame_forward(observed: Observed) -> Forward:
    """Return the forward model of every single frame, or of the hold means if there are no frames."""
    dataset = observed.dataset
    if dataset.frames is None:
        return observed.fitter.forward
    session = gap_session(dataset, Binning(*[len(dataset.frames)] * 4))
    return observed.forward_of(remove_faults(session, observed.faults))
