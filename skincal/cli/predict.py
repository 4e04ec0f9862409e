"""``skincal predict``: predict the images of a dataset's presses from a calibration."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from skincal.cli.common import (
    CalibrationArgument,
    DatasetArgument,
    ForceOption,
    JsonOption,
    OutOption,
    example,
    print_json,
    say,
    warn,
)
from skincal.progress import stage_bars

if TYPE_CHECKING:
    from skincal.dataset import Dataset
    from skincal.dataset.writing import Format
    from skincal.prediction import Prediction

EPILOG = example(
    "skincal predict cal data/paper-like --out predicted",
    "skincal predict cal data/paper-like --out predicted --slack --json",
)


def predict(
    cal: CalibrationArgument,
    dataset: DatasetArgument,
    out: OutOption,
    slack: Annotated[
        bool,
        typer.Option(
            "--slack", help="Move every press to the best position within its slack, and write that position."
        ),
    ] = False,
    as_json: JsonOption = False,
    force: ForceOption = False,
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
    with stage_bars() as reporter:
        prediction = predict_dataset(calibration, data, slack=slack, progress=reporter)
    write_dataset(
        prediction.dataset,
        out,
        presses_as=_format(data, "presses", "csv"),
        frames_as=_format(data, "frames", "parquet"),
        force=force,
    )
    warn(prediction.warnings)
    if as_json:
        print_json(_as_json(out, prediction))
        return
    say(_summary_text(out, prediction))


def _format(data: Dataset, stem: str, otherwise: Format) -> Format:
    """Return the format of a table of the dataset, or ``otherwise`` for a table that it lacks."""
    folder = data.folder
    if folder is None:
        return otherwise
    if (folder / f"{stem}.parquet").is_file():
        return "parquet"
    return "csv" if (folder / f"{stem}.csv").is_file() else otherwise


def _as_json(out: Path, prediction: Prediction) -> dict[str, Any]:
    frames, of_frames = prediction.dataset.frames, prediction.frames
    return {
        "dataset": out,
        "presses": len(prediction.dataset.presses),
        "frames": 0 if frames is None else len(frames),
        "rmse_counts": prediction.presses.rmse_counts,
        "rmse_with_rest_counts": prediction.presses.rmse_with_rest_counts,
        "frames_rmse_counts": None if of_frames is None else of_frames.rmse_counts,
        "frames_rmse_with_rest_counts": None if of_frames is None else of_frames.rmse_with_rest_counts,
        "slack_rms_m": prediction.slack_rms_m,
        "abstaining": prediction.abstaining,
    }


def _summary_text(out: Path, prediction: Prediction) -> str:
    data, rmse = prediction.dataset, prediction.presses
    unit = data.meta.sensor.unit_label
    lines = [
        f"{len(data.presses)} presses predicted: measured images differ by {rmse.rmse_with_rest_counts:.3g} {unit} rms "
        f"per taxel ({rmse.rmse_counts:.3g} without the level at rest)"
    ]
    if data.frames is not None and prediction.frames is not None:
        of_frames = prediction.frames
        lines.append(
            f"{len(data.frames)} frames predicted: those with contact differ by {of_frames.rmse_with_rest_counts:.3g} "
            f"({of_frames.rmse_counts:.3g})"
        )
    if prediction.slack_rms_m is not None:
        lines.append(f"presses moved by {1e3 * prediction.slack_rms_m:.2f} mm rms along each direction")
    return "\n".join([*lines, f"dataset: {out}"])
