"""The prediction of a dataset by a calibration, and its mismatch with the measurement."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeVar

import numpy as np

from skincal.calibration import MARGIN_M, Calibration, Effect, check_same_sensor
from skincal.dataset import IDLE, Dataset, DatasetMeta, Frames, Presses, idle_means
from skincal.dataset.uniform_pressure import centre_contacts, uniform_pressure, zero_load_levels
from skincal.effects import COVARIATES, EFFECTS
from skincal.errors import Problem
from skincal.fitting.observe import ImagesAboveRest, Readout, expected_counts, observe
from skincal.fitting.types import Bools, Floats
from skincal.prediction.holds import best_slack, idle_memory_residual, rest_level
from skincal.prediction.images import images_with_effects
from skincal.prediction.session_samples import pose_names, session_samples
from skincal.prediction.touches import CalibratedSkin, Touches, frame_presses, touching
from skincal.version import __version__

Table = TypeVar("Table", Presses, Frames)

Progress = Callable[[str, int, int], None]
"""Progress callback: stage, amount done, total amount."""


@dataclass(frozen=True)
class Mismatch:
    """Root mean square difference per taxel between measured and predicted counts, during contact.

    Attributes:
        rmse_counts: difference of the columns as they are. A prediction has no noise, but clipped noise lifts the mean
            of an untouched taxel slightly above 0, which counts as a difference.
        rmse_with_rest_counts: difference after the contributions of the session's noise and rest level are added to the
            prediction: comparable with the loss of a fit and with the noise.
    """

    rmse_counts: float
    rmse_with_rest_counts: float


@dataclass(frozen=True, eq=False)
class Prediction:
    """Prediction of a dataset by a calibration.

    Attributes:
        dataset: the given dataset with predicted values in the taxel columns.
        frames: mismatch of the frames with contact; None without frames.
        presses: mismatch of the presses.
        slack_m: (K, 2) estimated slack of the presses, across and along [m]; None with measured positions.
        abstaining: effects that are left out, with the covariates that the dataset lacks.
        warnings: warnings about these effects and other problems.
    """

    dataset: Dataset
    presses: Mismatch
    frames: Mismatch | None
    slack_m: Floats | None
    abstaining: Mapping[str, tuple[str, ...]]
    warnings: tuple[Problem, ...]

    @property
    def slack_rms_m(self) -> float | None:
        """Root mean square slack along one direction [m]."""
        return None if self.slack_m is None else rms(self.slack_m)


def predict_dataset(
    calibration: Calibration,
    dataset: Dataset,
    *,
    slack: bool = False,
    progress: Progress = lambda _stage, _done, _total: None,
) -> Prediction:
    """Predict the images of all presses and frames of a dataset (contract, section 6).

    Values are those of the model, clipped to the range of the dataset's converter, neither rounded nor noisy and
    without a level at rest: an untouched taxel is 0. The indenter is the dataset's, with a press's own radius if given;
    force is the measured one. A frame has its own position and force; an idle one has no load.

    Effects of the calibration act on frames in the order of time, and a press is the mean over the frames of its hold.
    Without frames a standard press is simulated. An effect whose covariates are missing is left out and reported.

    Args:
        calibration: the calibration.
        dataset: dataset with the contacts.
        slack: True to move each press, with all its frames, to the best position within its slack: least squares of
            the absolute hold image, plus the prior of the measured position. The result has the moved positions.
        progress: progress callback.

    Returns:
        The predicted dataset, and its mismatch with the measured one.

    Raises:
        InputError: the dataset has another sensor or another surface.
        WorkError: the calibration cannot be simulated.
    """
    check_same_sensor(calibration, dataset)
    given, dataset = dataset, centre_contacts(dataset, MARGIN_M)
    on = CalibratedSkin.of(calibration, dataset, pose_names(dataset))
    seen = observed_images(dataset, idle_memory_residual(on, dataset))
    slack = slack and dataset is given  # under uniform pressure the image does not depend on the position
    slack_m = best_slack(on, dataset, seen, partial(progress, "slack")) if slack else None
    of_holds, of_time = _images(on, dataset, slack_m, progress)
    level = rest_level(on, dataset) if on.has_effects else 0.0
    presses = replace(given.presses, counts=of_holds)
    if slack_m is not None:
        presses = _moved(presses, Touches.of_presses(on, dataset, slack_m), slack_m)
    measured, pressed = dataset.presses.counts, dataset.presses.force_n > 0
    of_presses = mismatch(dataset, measured, presses.counts, pressed, seen, level)
    frames, of_frames = None, None
    if given.frames is not None and of_time is not None:
        contact = touching(dataset)
        frames = replace(given.frames, counts=of_time)
        if slack_m is not None:
            moves = np.where(contact[:, None], slack_m[frame_presses(dataset)], 0.0)
            frames = _moved(frames, Touches.of_frames(on, dataset, slack_m), moves)
        of_frames = mismatch(dataset, given.frames.counts, frames.counts, contact, seen, level)
    lacking = abstaining(on, dataset)
    added = [one.effect.name for one in on.full.effects if not one.neutral and one.effect.name not in lacking]
    meta = _meta(calibration, given, added, slack)
    new = replace(given, meta=meta, presses=presses, frames=frames, folder=None, sha256=None, warnings=())
    warnings = abstaining_problems(calibration, dataset, lacking)
    return Prediction(new, of_presses, of_frames, slack_m, lacking, warnings)


def _images(
    on: CalibratedSkin, dataset: Dataset, slack_m: Floats | None, progress: Progress
) -> tuple[Floats, Floats | None]:
    """Return the images of the presses and of the frames; by the base model, each is independent."""
    readout, no_frames = partial(within_range, dataset), dataset.frames is None
    if on.has_effects:
        told = partial(progress, "presses" if no_frames else "frames")
        return images_with_effects(on, dataset, slack_m, readout, told)[0]
    presses = Touches.of_presses(on, dataset, slack_m).values(partial(progress, "presses"))
    if no_frames:
        return readout(presses), None
    frames = Touches.of_frames(on, dataset, slack_m).values(partial(progress, "frames"))
    return readout(presses), readout(frames)


def _readout(dataset: Dataset) -> Readout:
    sensor = dataset.meta.sensor
    return Readout(sensor.value_min, sensor.value_max, sensor.integer, sensor.baseline == "subtracted")


def observed_images(dataset: Dataset, left_counts: Floats | float = 0.0) -> ImagesAboveRest:
    """Return the measured images as unclipped values above rest.

    The rest level comes from idle frames if there are enough, else from the presses that do not touch a taxel. Uniform
    pressure touches all taxels; then the level is extrapolated to zero force.

    Args:
        dataset: dataset of the presses.
        left_counts: (J,) contribution of memory to the idle frames, which is subtracted [counts].
    """
    idle = idle_means(dataset)
    if idle is None and uniform_pressure(dataset):
        idle = zero_load_levels(dataset)
    return observe(dataset.presses.counts, _readout(dataset), None if idle is None else idle - left_counts)


def within_range(dataset: Dataset, values: Floats) -> Floats:
    """Return the values (N, J) clipped to the range of the dataset's converter, not rounded [counts]."""
    return replace(dataset.converter(), integer=False).apply(values)


def mismatch(
    dataset: Dataset,
    measured: Floats,
    predicted: Floats,
    contact: Bools,
    seen: ImagesAboveRest,
    level_counts: Floats | float = 0.0,
) -> Mismatch:
    """Return the mismatch of presses or frames.

    Args:
        dataset: dataset of the rows, for its converter.
        measured: (N, J) measured counts.
        predicted: (N, J) predicted counts.
        contact: (N,) True for the rows that are compared.
        seen: images with the session's noise and rest level.
        level_counts: (J,) rest level in the prediction, which the session's replaces [counts].
    """
    counts, values = measured[contact], predicted[contact]
    above_rest = values - np.maximum(level_counts, 0.0)
    if np.isfinite(seen.frame_sigma_counts):
        readout = _readout(dataset)
        above = seen.rest_counts + (readout.value_min or 0.0)
        with_rest = expected_counts(above_rest + above, seen.frame_sigma_counts, readout)
    else:
        with_rest = within_range(dataset, above_rest + np.nan_to_num(seen.rest_counts))
    return Mismatch(rms(counts - values), rms(counts - with_rest))


def rms(values: Floats) -> float:
    """Return the root mean square of the known values; NaN if there are none."""
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if known.size else float("nan")


def _moved(table: Table, touches: Touches, slack_m: Floats) -> Table:
    """Return a table of presses or frames with the contact positions of ``touches`` in rows with slack (N, 2) [m]."""
    moved = (slack_m != 0).any(axis=1)[:, None]
    return replace(table, position_m=np.where(moved, touches.points_m, table.position_m))


def _meta(calibration: Calibration, dataset: Dataset, added: list[str], slack: bool) -> DatasetMeta:
    """Return the metadata of the predicted dataset; ``added`` are the names of the effects that act."""
    meta, origin = dataset.meta, calibration.provenance
    name = "a calibration" if calibration.folder is None else f"the calibration {calibration.folder.name}"
    fitted = f" (fitted to {origin.dataset or 'a dataset'} {origin.dataset_sha256[:12]})".rstrip()
    places = (
        "contact positions moved to the best within their slack" if slack else "contact positions as measured"
    )
    effects = f"effects {', '.join(added)}, " if added else ""
    source = (
        f"taxel values predicted by {name}{fitted} with skincal {__version__}, {effects}{places}; "
        f"of: {meta.source or '–'}"
    )
    return replace(meta, source=source, sensor=replace(meta.sensor, integer=False))


_LEFT_OUT = "The prediction leaves it out."


def abstaining(on: CalibratedSkin, dataset: Dataset) -> dict[str, tuple[str, ...]]:
    """Return the names of effects that are left out, each with its missing covariates."""
    if not on.has_effects:
        return {}
    touches = Touches.of_presses(on, dataset) if dataset.frames is None else Touches.of_frames(on, dataset)
    samples = session_samples(touches, dataset, pose_names(dataset))
    lacking = {
        one.effect.name: tuple(name for name in one.needs if not samples.has(name))
        for one in on.full.effects
        if not one.neutral
    }
    return {name: missing for name, missing in lacking.items() if missing}


def abstaining_problems(
    calibration: Calibration, dataset: Dataset, lacking: Mapping[str, tuple[str, ...]]
) -> tuple[Problem, ...]:
    """Return warnings about effects that are left out, and about hand poses without parameters in the calibration."""
    place = "the dataset" if dataset.folder is None else str(dataset.folder)
    found = [
        Problem(f"{place}, for the effect {name}", _columns(missing), "none", _LEFT_OUT)
        for name, missing in lacking.items()
    ]
    found += [
        problem for one in calibration.effects for problem in _partial_columns(one, dataset, place, lacking)
    ]
    poses = pose_names(dataset)
    for one in calibration.effects:
        several = any(isinstance(v, tuple) and len(v) > 1 for v in one.parameters.values())
        new = [pose for pose in poses if pose not in one.poses]
        if one.poses and several and new:
            where = f"{place}, column pose, for the effect {one.name}"
            fix = "It is neutral in other poses."
            found.append(Problem(where, f"the poses {', '.join(one.poses)}", ", ".join(new), fix))
    return tuple(found)


def _columns(missing: tuple[str, ...]) -> str:
    """Return the columns that provide missing covariates, as words of a message."""
    # Phases come with the times, and a site's largest force with the count of its touches: name only the source.
    named = [name for name in missing if COVARIATES[name].comes_with not in missing]
    return " and ".join(sorted({str(COVARIATES[name]) for name in named}))


def _partial_columns(
    effect: Effect, dataset: Dataset, place: str, lacking: Mapping[str, tuple[str, ...]]
) -> list[Problem]:
    """Return warnings about covariates of an effect that are empty in a part of the rows."""
    if effect.name in lacking:
        return []
    found: list[Problem] = []
    frames = dataset.frames
    one = EFFECTS[effect.name]
    at_work = {p.name for p in one.parameters if _is_active(effect, p.name, p.neutral)}
    needs = {*one.covariates, *(need for p in one.parameters if p.name in at_work for need in p.needs)}
    for name in sorted(needs):
        for column in COVARIATES[name].columns:
            values = None if frames is None else frames.column(column)
            what = "frames under load"
            if values is not None and frames is not None:
                values = values[frames.phase != IDLE]
            else:
                values, what = dataset.presses.column(column), "presses"
            empty = 0 if values is None else int(np.isnan(values).sum())
            if values is not None and 0 < empty < len(values):
                got = f"empty in {empty} of {len(values)} {what}"
                fix = "The effect is left out there, which makes steps: fill the cells, or remove the column."
                found.append(
                    Problem(f"{place}, column {column}, for the effect {effect.name}", "a value", got, fix)
                )
    return found


def _is_active(effect: Effect, name: str, neutral: float) -> bool:
    """Return whether a parameter of an effect differs from its neutral value."""
    return name in effect.parameters and bool(np.any(np.asarray(effect.parameters[name]) != neutral))
