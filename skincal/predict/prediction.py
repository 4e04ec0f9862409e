"""A dataset as a calibration predicts it, and how far that is from what was measured."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from skincal import __version__
from skincal.calibration import Calibration, check_same_sensor
from skincal.dataset import Dataset, DatasetMeta, Frames, Presses
from skincal.fit.observe import Observed
from skincal.predict.mismatch import Mismatch, mismatch, observed_images, rms, within_range
from skincal.predict.places import Seen, best_places
from skincal.predict.touches import CalibratedSkin, Touches, frame_presses, touching

Floats = NDArray[np.floating[Any]]
Table = TypeVar("Table", Presses, Frames)

Progress = Callable[[str, int, int], None]
"""Told the stage, how much of it is done, and of how much."""


def _silent(_stage: str, _done: int, _total: int) -> None:
    return


@dataclass(frozen=True, eq=False)
class Prediction:
    """What a calibration says of a dataset.

    Attributes:
        dataset: like the one that was predicted, with predicted values in the taxel columns.
        presses: mismatch of the presses.
        frames: mismatch of the frames with contact; None where there are none.
        slack_m: (K, 2) chosen slack of the presses, across and along [m]; None where positions are as measured.
    """

    dataset: Dataset
    presses: Mismatch
    frames: Mismatch | None
    slack_m: Floats | None

    @property
    def slack_rms_m(self) -> float | None:
        """Root mean square slack along one direction [m]."""
        return None if self.slack_m is None else rms(self.slack_m)


def predict_dataset(
    calibration: Calibration, dataset: Dataset, *, slack: bool = False, progress: Progress = _silent
) -> Prediction:
    """Predicts the images of all presses and frames of a dataset (contract, section 6).

    Values are those of the model, clipped to the range of the dataset's converter, neither rounded nor noisy and
    without a level at rest: an untouched taxel is 0. The indenter is the dataset's, a press's own radius first; the
    force is the measured one. A frame has its own position and force; an idle one has no load.

    Args:
        calibration: the skin.
        dataset: contacts to predict.
        slack: whether each press, with all its frames, is moved to the best position within its slack: least
            squares of the absolute hold image, plus what the measured position is worth. The result then has the
            moved positions.
        progress: told how far the work is.

    Returns:
        The predicted dataset and how far it is from the measured one.

    Raises:
        InputError: the dataset is of another sensor, or of another surface.
        WorkError: the calibration cannot be simulated.
    """
    check_same_sensor(calibration, dataset)
    on, seen = CalibratedSkin.of(calibration, dataset), observed_images(dataset)
    measured = Touches.of_presses(on, dataset)
    slack_m = _best_slack(measured, dataset, seen, progress) if slack else None
    presses = _predicted(
        measured, slack_m, dataset.presses, dataset, lambda n, of: progress("presses", n, of)
    )
    of_presses = mismatch(dataset, dataset.presses.counts, presses.counts, dataset.presses.force_n > 0, seen)
    seen_frames, frames, of_frames = dataset.frames, None, None
    if seen_frames is not None:
        contact = touching(dataset)
        moves = None if slack_m is None else np.where(contact[:, None], slack_m[frame_presses(dataset)], 0.0)
        touches = Touches.of_frames(on, dataset)
        frames = _predicted(touches, moves, seen_frames, dataset, lambda n, of: progress("frames", n, of))
        of_frames = mismatch(dataset, seen_frames.counts, frames.counts, contact, seen)
    meta = _meta(calibration, dataset, slack)
    new = replace(dataset, meta=meta, presses=presses, frames=frames, folder=None, sha256=None, warnings=())
    return Prediction(new, of_presses, of_frames, slack_m)


def _predicted(
    touches: Touches,
    slack_m: Floats | None,
    table: Table,
    dataset: Dataset,
    progress: Callable[[int, int], None],
) -> Table:
    """A table of presses or frames with predicted values, and where there is slack, with moved positions."""
    if slack_m is not None:
        touches = touches.moved(slack_m)
        moved = (slack_m != 0).any(axis=1)
        table = replace(table, position_m=np.where(moved[:, None], touches.points_m, table.position_m))
    return replace(table, counts=within_range(dataset, touches.values(progress)))


def _best_slack(presses: Touches, dataset: Dataset, seen: Observed, progress: Progress) -> Floats:
    """The best slack (K, 2) of the presses; one whose position is not known, or that has no force, stays."""
    progress("slack", 0, 1)
    free = np.flatnonzero(np.isfinite(dataset.presses.position_m).all(axis=1) & (dataset.presses.force_n > 0))
    read = np.isfinite(seen.values[free])
    scatter = seen.rest_sigma_counts if np.isfinite(seen.rest_sigma_counts) else 0.0
    values, weight = np.where(read, seen.values[free], 0.0), np.where(read, seen.slope[free], 0.0)
    lit = read & (values > max(4 * scatter, 0.5))
    images = Seen(values, weight, seen.saturated[free] & read, lit, max(scatter, 0.05))
    measured = presses.taken(free)

    def simulate(slack_m: Floats, press: NDArray[np.intp]) -> Floats:
        return measured.taken(press).moved(slack_m).values()

    spec = dataset.meta.position
    bound = spec.slack_m if np.isfinite(spec.slack_m) else _patch_size_m(presses.on)
    slack = np.zeros((len(presses), 2))
    slack[free] = best_places(simulate, images, spec.sigma_m, bound).slack_m
    progress("slack", 1, 1)
    return slack


def _patch_size_m(on: CalibratedSkin) -> float:
    """Half of the patch's longer side: where the slack is not bounded, a press still lies on the patch."""
    low, high = on.skin.patch.layout.bounds_m
    return float((high - low).max()) / 2


def _meta(calibration: Calibration, dataset: Dataset, slack: bool) -> DatasetMeta:
    meta, origin = dataset.meta, calibration.provenance
    name = "a calibration" if calibration.folder is None else f"the calibration {calibration.folder.name}"
    fitted = f" (fitted to {origin.dataset or 'a dataset'} {origin.dataset_sha256[:12]})".rstrip()
    places = (
        "contact positions moved to the best within their slack" if slack else "contact positions as measured"
    )
    source = f"taxel values predicted by {name}{fitted} with skincal {__version__}, {places}; of: {meta.source or '–'}"
    return replace(meta, source=source, sensor=replace(meta.sensor, integer=False))
