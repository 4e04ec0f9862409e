"""``skincal predict``: predict the images of a dataset's presses from a calibration."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from skincal.cli import options
from skincal.cli.options import example, option
from skincal.cli.terminal import answer, warn
from skincal.progress import stage_bars

if TYPE_CHECKING:
    from skincal.dataset import Dataset
    from skincal.dataset.folder import Format
    from skincal.prediction import Prediction

EPILOG = example(
    "skincal predict cal data/paper-like --out predicted",
    "skincal predict cal data/paper-like --out predicted --slack --json",
)

_SLACK = "Move every press to the best position within its slack, and write that position."


def predict(
    cal: options.Calibration,
    dataset: options.Dataset,
    out: options.Out,
    slack: Annotated[bool, option(_SLACK, "--slack")] = False,
    as_json: options.Json = False,
    force: options.Force = False,
) -> None:
    """Write a dataset as a calibration predicts it, effects included.

    The taxel columns hold the model's values within the converter's range, neither rounded nor noisy. An untouched
    taxel is 0, without the level that clipped noise gives it at rest. Presses and frames have their measured forces
    and positions, or with --slack the best positions. Effects run through the frames in time order, or through a
    standard press where there are no frames. An effect that needs a covariate which the dataset lacks is left out, with
    a warning.
    """
    from skincal.calibration import read_calibration
    from skincal.dataset import read_dataset, write_dataset
    from skincal.files import refuse_existing
    from skincal.prediction import predict_dataset

    refuse_existing(out, dataset, cal, force=force, marker="dataset.toml")
    calibration, data = read_calibration(cal), read_dataset(dataset)
    warn((*calibration.warnings, *data.warnings))
    with stage_bars() as progress:
        found = predict_dataset(calibration, data, slack=slack, progress=progress)
    formats = _format(data, "presses", "csv"), _format(data, "frames", "parquet")
    write_dataset(found.dataset, out, presses_as=formats[0], frames_as=formats[1], force=force)
    warn(found.warnings)
    answer(as_json, _as_json(out, found), then="\n".join([*_lines(found), f"dataset: {out}"]))


def _format(data: Dataset, stem: str, otherwise: Format) -> Format:
    """Return the format of a table of the dataset, or ``otherwise`` for a table that it lacks."""
    formats: tuple[Format, ...] = ("parquet", "csv")
    if data.folder is not None:
        for known in formats:
            if (data.folder / f"{stem}.{known}").is_file():
                return known
    return otherwise


def _as_json(out: Path, found: Prediction) -> dict[str, Any]:
    frames = found.frames
    return {
        "dataset": out,
        "presses": len(found.dataset.presses),
        "frames": 0 if found.dataset.frames is None else len(found.dataset.frames),
        "rmse_counts": found.presses.rmse_counts,
        "rmse_with_rest_counts": found.presses.rmse_with_rest_counts,
        "frames_rmse_counts": None if frames is None else frames.rmse_counts,
        "frames_rmse_with_rest_counts": None if frames is None else frames.rmse_with_rest_counts,
        "slack_rms_m": found.slack_rms_m,
        "abstaining": found.abstaining,
    }


def _lines(found: Prediction) -> list[str]:
    data, rmse, frames = found.dataset, found.presses, found.frames
    lines = [
        f"{len(data.presses)} presses predicted: measured images differ by {rmse.rmse_with_rest_counts:.3g} "
        f"{data.meta.sensor.unit_label} rms per taxel ({rmse.rmse_counts:.3g} without the level at rest)"
    ]
    if data.frames is not None and frames is not None:
        error = f"{frames.rmse_with_rest_counts:.3g} ({frames.rmse_counts:.3g})"
        lines.append(f"{len(data.frames)} frames predicted: those with contact differ by {error}")
    if found.slack_rms_m is not None:
        lines.append(f"presses moved by {1e3 * found.slack_rms_m:.2f} mm rms along each direction")
    return lines
