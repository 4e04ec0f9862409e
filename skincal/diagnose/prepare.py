"""From a dataset and a calibration to what a diagnosis works on."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from skincal.calibration import MARGIN_M, Calibration
from skincal.calibration.skin import effects_of
from skincal.dataset import Dataset, Frames, idle_means
from skincal.dataset.refusal import refusal
from skincal.dataset.uniform import borne, uniform_pressure
from skincal.diagnose.base import calibrated_model, floor_of, hold_slopes, thinned
from skincal.diagnose.options import DiagnoseOptions
from skincal.diagnose.phases import check_phases
from skincal.diagnose.session import gap_session, hold_groups, pose_names, press_rows, rest_means
from skincal.effects import EFFECTS
from skincal.errors import InputError, Problem
from skincal.fit.observe import Readout, expected_counts
from skincal.gap.base import BaseModel, base_columns
from skincal.gap.hypothesis import PLACE, Hypothesis, Parameters
from skincal.gap.noise import (
    ASSUMED,
    CLIPPED,
    LEFT_BY_FIT,
    REPEATS,
    NoiseFloor,
    force_scatter,
    rounding,
)
from skincal.gap.problem import RefitOptions
from skincal.gap.reading import Reading
from skincal.inference.session import Binning, GapSession
from skincal.gap.signatures import session_mean
from skincal.gap.split import FINAL, SELECTION, TRAIN, Split, SplitOptions, split_presses
from skincal.gap.start import start_places
from skincal.model.arrays import FloatArray, IntArray, as_floats
from skincal.predict.sites import sites

FORCE_SIGMA = 0.004
"""By how much the force of a whole press may be off, relative, before that is an effect of its own."""

GAUGE_SIGMA = 0.001
"""The same for the gauge of a chamber: it errs all along, not from one plateau to the next. What all taxels do alike
would be taken for its error otherwise."""

EXACT_M = 1e-4
"""What the place of uniform pressure is worth: it does not matter."""

OFFSET = "taxel_offset"
_SETTLED = 20
"""Steps to the level at rest of which clipped noise makes a mean; each halves the error or more."""

_HIGH_COUNTS, _HIGH_SIGMA = 5.0, 5.0
"""Beyond both a level at rest is so high that places and forces would make up for it, were it left out."""

_SAME_COUNTS, _SAME_SIGMA, _FEWEST_IMAGES = 1.0, 6.0, 3
"""An image differs from the usual one if some taxel is off by more than both, and so many presses must."""

FEWEST_PRESSES = 12
"""Fewer cannot be fitted, choose and be kept for the end."""


@dataclass(frozen=True, eq=False)
class Prepared:
    """A session ready to be diagnosed.

    Attributes:
        session: what was pressed, presses where they were measured.
        reading: what was read.
        floor: the noise.
        start: sensor, effects that the calibration has already, and where presses were to a first guess.
        known_effects: the same effects.
        poses: names of the hand poses, by their numbers.
        split: of the presses.
        part: (N,) part of each observation; one at rest goes with the press before it.
        options: priors of a refit.
        full: observations at the frame rate; the same as ``session`` where there are no frames.
        full_reading: what was read of them.
        force_noise_n: of the measured force of a frame [N].
        rest_counts: (J,) level at rest of all taxels of the layout, where it is so high that no model without it can
            be fitted; None where it is not.
    """

    session: GapSession
    reading: Reading
    floor: NoiseFloor
    start: Hypothesis
    known_effects: dict[str, Parameters]
    poses: tuple[str, ...]
    split: Split
    part: IntArray
    options: RefitOptions
    full: GapSession
    full_reading: Reading
    force_noise_n: float
    rest_counts: FloatArray | None = None

    def is_part(self, *parts: int) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """(N,) observations of some parts."""
        return np.isin(self.part, parts)


def prepare(
    dataset: Dataset, calibration: Calibration, options: DiagnoseOptions, rng: np.random.Generator
) -> Prepared:
    """Reads a session as a diagnosis needs it.

    Raises:
        WorkError: too few presses have a known place and a force.
        InputError: there is no position at all.
    """
    uniform = uniform_pressure(dataset)
    if not uniform and not np.isfinite(dataset.meta.position.sigma_m):
        place = "dataset.toml" if dataset.folder is None else str(dataset.folder / "dataset.toml")
        fix = "Only of uniform pressure, a flat punch larger than the patch, need no place be known."
        raise InputError([Problem(f"{place}: [position] sigma_m", "places that were measured", "inf", fix)])
    whole = gap_session(dataset)
    presses = len(np.unique(whole.press[whole.press >= 0]))
    if presses < FEWEST_PRESSES:
        check_phases(dataset, FEWEST_PRESSES)
        raise refusal(
            dataset,
            f"expected {FEWEST_PRESSES} presses with a known place and a force at least, because some are fitted, "
            f"some choose and some are kept for the end; got {presses}. Record more presses",
        )
    model = calibrated_model(calibration, dataset)
    session = thinned(model, whole)
    floor = floor_of(dataset, None, rng, session.taxels)
    if not session.has_frames and floor.frame_from != CLIPPED:
        # Nothing shows the noise of a frame; repeats may show that of a mean.
        slopes = hold_slopes(session, base_columns(model, session), len(dataset.presses))
        floor = floor_of(dataset, slopes, rng, session.taxels)
    _check_answers(dataset, floor)
    # The level at rest is compared with what the data themselves say of the noise.
    of_data, floor = floor, _bounded(session, floor, calibration)
    session = _weighted(session, floor, model)
    sigma = floor.sigma_counts
    reading = Reading.of(session, sigma, model.readout)
    extra = calibration.loss.extra
    # Where every place looks the same, any will do.
    measured_m = EXACT_M if uniform else dataset.meta.position.sigma_m
    sigma_m = _positive(extra.get("position_sigma_m"), measured_m)
    # What a fit found of the positions counts where it is sharper than what the data say. What it found of the forces
    # does not: a gain that drifts looks like forces that are off, and would then be explained away.
    # Uniform pressure tells nothing of pose and E, and S cannot be told from the forces.
    refit = RefitOptions(min(sigma_m, measured_m), GAUGE_SIGMA if uniform else FORCE_SIGMA, base=not uniform)
    reach = dataset.meta.position.slack_m
    reach = reach if np.isfinite(reach) and reach > 0 else options.reach_m
    names = pose_names(dataset)
    known: dict[str, Parameters] = dict(effects_of(calibration, names))
    rest = None if OFFSET in known else high_rest(dataset, of_data, model.readout)
    places = np.zeros((session.presses, PLACE))
    if not uniform:
        above = session if rest is None else _lowered(session, rest)
        seen = reading if above is session else Reading.of(above, sigma, model.readout)
        skin = Hypothesis(model, places, known).skin
        places = start_places(skin, above, seen, sigma_m, min(reach, 3 * options.reach_m))
    split = _split(dataset, session, rng)
    full = session if not session.has_frames else _full(dataset, session)
    return Prepared(
        session,
        reading,
        floor,
        Hypothesis(model, places, known),
        known,
        names,
        split,
        _parts(session, split),
        refit,
        full,
        Reading.of(full, sigma, model.readout),
        _force_noise(dataset),
        rest,
    )


def _check_answers(dataset: Dataset, floor: NoiseFloor) -> None:
    """Refuses presses that all left the same image: there is nothing that a model could be compared with.

    Raises:
        WorkError: fewer than a few presses differ from the usual image, in their table or in the frames.
    """
    # A noise that is only assumed refuses nobody, nor do counts that are no whole numbers and may be in any unit.
    noise = 0.0 if floor.mean_from == ASSUMED else _SAME_SIGMA * floor.mean_counts
    least = max(_SAME_COUNTS if dataset.meta.sensor.integer else 0.0, noise)
    images = {"": dataset.presses.counts}
    if dataset.frames is not None:
        images["the frames of "] = _means_of_frames(dataset, dataset.frames)
    for of, read in images.items():
        counts = read[:, np.isfinite(read).any(axis=0)]
        off = np.abs(counts - np.nanmedian(counts, axis=0)) if counts.size else counts
        differ = int((off > least).any(axis=1).sum())
        if differ < _FEWEST_IMAGES:
            which = f"{of}all {len(counts)} presses"
            which = which if not differ else f"{of}all but {differ} of {len(counts)} presses"
            raise refusal(
                dataset,
                f"expected images that differ from press to press; got the same one, but for noise, in {which}. Does "
                "the sensor answer at all? Look at it with `skincal dataset show`; press other places with other "
                "forces",
            )


def _means_of_frames(dataset: Dataset, frames: Frames) -> FloatArray:
    """Mean counts (P, J) of the frames in contact of each press; NaN where there are none."""
    rows = press_rows(dataset)
    read = np.where((rows >= 0)[:, None], frames.counts, np.nan)
    total, number = np.zeros((2, len(dataset.presses), read.shape[1]))
    known = np.isfinite(read)
    np.add.at(total, np.maximum(rows, 0), np.where(known, read, 0.0))
    np.add.at(number, np.maximum(rows, 0), known)
    return np.where(number > 0, total / np.maximum(number, 1), np.nan)


def _force_noise(dataset: Dataset) -> float:
    """Noise of the measured force of a frame, as far as the modelled skin bears it [N]."""
    if dataset.frames is None:
        return 0.0
    share = float(np.median(borne(dataset, MARGIN_M)))
    return share * force_scatter(dataset.frames.force_n, hold_groups(dataset))


def high_rest(dataset: Dataset, floor: NoiseFloor, readout: Readout) -> FloatArray | None:
    """The level at rest (J,) beyond what clipped noise makes of zero, if most taxels are far above it."""
    means = idle_means(dataset) if uniform_pressure(dataset) else rest_means(dataset)
    if means is None or readout.rest_subtracted:
        return None
    level = as_floats(np.nan_to_num(means))
    for _ in range(_SETTLED):
        # What noise that is clipped adds to a level depends on how near to the bound it is.
        level = np.nan_to_num(means - (expected_counts(level, floor.frame_counts, readout) - level))
    offset = EFFECTS[OFFSET].parameters[0]
    level = np.clip(level, offset.low, offset.high)
    return level if np.median(np.abs(level)) > max(_HIGH_COUNTS, _HIGH_SIGMA * floor.frame_counts) else None


def _lowered(session: GapSession, rest: FloatArray) -> GapSession:
    assert session.counts is not None
    return replace(
        session, counts=session.counts - (rest if session.taxels is None else rest[session.taxels])
    )


def _bounded(session: GapSession, floor: NoiseFloor, calibration: Calibration) -> NoiseFloor:
    """The floor as it is used: where nothing shows the noise of a frame, what is known of a hold mean's.

    What the fit left, and how far repeats differ, are bounds of it from above: what the model lacks is in the one,
    where presses do not come back in the other.
    """
    if session.has_frames or floor.frame_from == CLIPPED:
        return floor
    low, high = floor.mean_interval
    left = _positive(calibration.loss.extra.get("noise_sigma_counts"), np.inf)
    if not np.isfinite(left):
        return floor.of_means(floor.mean_counts, (low, high), floor.mean_from)
    if floor.mean_from == REPEATS and high <= left:
        return floor.of_means(high, (low, high), REPEATS)
    # Untouched taxels show the least that it can be; repeats and what is assumed do not.
    shown = floor.measured and floor.mean_from != REPEATS
    return floor.of_means(left, (min(low, left) if shown else 0.0, left), LEFT_BY_FIT)


def _weighted(session: GapSession, floor: NoiseFloor, model: BaseModel) -> GapSession:
    """The session with the number of frames that each observation is worth."""
    if session.has_frames:
        return session
    full = float(np.hypot(floor.frame_counts, rounding(model.readout)))
    return replace(session, frames=np.full(len(session), max(1.0, (full / floor.mean_counts) ** 2)))


def _full(dataset: Dataset, session: GapSession) -> GapSession:
    """Every frame an observation of its own."""
    whole = gap_session(dataset, Binning(*[len(dataset.frames or ())] * 4))
    return whole if session.taxels is None else whole.of_taxels(session.taxels)


def _split(dataset: Dataset, session: GapSession, rng: np.random.Generator) -> Split:
    """The split of all presses that were observed, in blocks of session time; no part waits for one that was not."""
    site = sites(dataset)
    rows, first = np.unique(session.press[session.press >= 0], return_index=True)
    order = rows[np.argsort(first, kind="stable")]
    part = np.full(len(site), TRAIN, dtype=np.int64)
    part[order] = split_presses(
        site[order], rng, SplitOptions(block=1) if uniform_pressure(dataset) else None
    ).part
    return Split(part)


def _parts(session: GapSession, split: Split) -> IntArray:
    """(N,) part of each observation; rest before the first press is learned from."""
    last = np.maximum.accumulate(np.where(session.press >= 0, np.arange(len(session)), -1))
    owner = np.where(last >= 0, session.press[np.maximum(last, 0)], -1)
    return np.where(owner >= 0, split.part[np.maximum(owner, 0)], TRAIN)


def _positive(value: object, otherwise: float) -> float:
    return float(value) if isinstance(value, int | float) and 0 < value < np.inf else otherwise


def force_variance(hypothesis: Hypothesis, session: GapSession, force_noise_n: float) -> FloatArray:
    """Variance (N, J) that the noise of the measured force makes in what a model says [counts²]."""
    if force_noise_n <= 0:
        return np.zeros_like(hypothesis.values(session))
    step = 0.02
    places = hypothesis.places.copy()
    places[:, 2] += step
    values = hypothesis.values(session)
    change = (hypothesis.with_places(places).values(session) - values) / step
    force = session_mean(session, np.where(session.samples.touching, session.samples.contacts.force_n, 0.0))
    per_n = np.divide(
        change, force[:, None], out=np.zeros_like(change), where=(force > 5 * force_noise_n)[:, None]
    )
    return np.nan_to_num(per_n * force_noise_n) ** 2 / session.frames[:, None]


__all__ = ["FEWEST_PRESSES", "FINAL", "SELECTION", "TRAIN", "Prepared", "force_variance", "prepare"]
