"""The main job from a notebook or a script, one function a verb; ``import skincal`` gives these names."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

from skincal.calibration import Calibration, read_calibration, skin_of, write_calibration
from skincal.dataset import Dataset, read_dataset, write_dataset
from skincal.errors import InputError, Problem
from skincal.model import Skin
from skincal.progress import stage_bars

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from skincal.calibrate import Outcome, UniformOutcome
    from skincal.diagnosis.diagnosis import Diagnosis
    from skincal.fitting.fit_options import FitOptions
    from skincal.prediction import Prediction
    from skincal.ranges import Ranges

__all__ = [
    "Skin",
    "diagnose",
    "export_ranges",
    "fit",
    "plot",
    "predict",
    "read_calibration",
    "read_dataset",
    "skin_of",
    "write_calibration",
    "write_dataset",
]


def fit(
    dataset: Dataset,
    *,
    options: FitOptions | None = None,
    seed: int = 0,
    workers: int | None = None,
    progress: bool = False,
) -> Outcome | UniformOutcome:
    """Fit pose, elasticity and scale to a dataset, as ``skincal fit`` does.

    Args:
        dataset: of :func:`read_dataset`.
        options: settings; None for the defaults.
        seed: of the draws.
        workers: processes; None for one a core. The result does not depend on it.
        progress: whether bars are shown.

    Returns:
        The fit; its ``calibration`` is what the other functions take. Of uniform pressure, which tells the scale of
        each taxel and neither pose nor elasticity, what such data give.

    Raises:
        WorkError: the presses do not allow a fit; says why and what to do.
    """
    from skincal.calibrate import calibrate, calibrate_uniform
    from skincal.dataset.uniform_pressure import uniform_pressure

    if uniform_pressure(dataset):
        return calibrate_uniform(dataset, seed=seed)
    with _bars(progress) as update:
        return calibrate(dataset, options=options, seed=seed, workers=workers, progress=update)


def predict(
    calibration: Calibration, dataset: Dataset, *, slack: bool = False, progress: bool = False
) -> Prediction:
    """Predict the images of a dataset's presses, as ``skincal predict`` does.

    Args:
        calibration: the skin, effects included.
        dataset: contacts to predict.
        slack: whether each press is moved to the best position within its slack.
        progress: whether bars are shown.

    Raises:
        InputError: the dataset is of another sensor.
    """
    from skincal.prediction import predict_dataset

    with _bars(progress) as update:
        return predict_dataset(calibration, dataset, slack=slack, progress=update)


def diagnose(
    dataset: Dataset,
    calibration: Calibration,
    *,
    seed: int = 0,
    progress: bool = False,
) -> Diagnosis:
    """Find what a calibrated simulation lacks against a dataset, as ``skincal diagnose`` does.

    Args:
        dataset: the session.
        calibration: of the same sensor.
        seed: of all randomness.
        progress: whether each stage is printed.

    Returns:
        The diagnosis; its ``calibration`` has what was named.

    Raises:
        InputError: the calibration is of another sensor.
        WorkError: too few presses.
    """
    from skincal.diagnosis.workflow import diagnose as run

    def announce(stage: str) -> None:
        if progress:
            print(stage, flush=True)

    return run(dataset, calibration, seed=seed, heard=announce)


def export_ranges(
    calibration: Calibration, path: str | Path | None = None, *, preset: str = "iros24", joint: bool = False
) -> Ranges:
    """Make domain randomization ranges from a calibration, as ``skincal export-dr`` does.

    Args:
        calibration: what is known.
        path: file to write (.toml, .json or .yaml), which must not exist; None: none is written.
        preset: published ranges for what the calibration does not know, ``iros24`` or ``icra26``.
        joint: whether the draws are kept, so that parameters are drawn together.

    Raises:
        InputError: no such preset, or the file exists.
    """
    from skincal.ranges import from_calibration, write_ranges

    ranges = from_calibration(calibration, preset, joint=joint)
    if path is not None:
        write_ranges(ranges, Path(path))
    return ranges


def plot(
    result: Dataset | Outcome | Diagnosis, figure: str | None = None, *, dataset: Dataset | None = None
) -> Figure:
    """Draw a figure of a report.

    Args:
        result: a dataset, a fit or a diagnosis.
        figure: which one, by the name that the report's file has (``valley``, ``images``, ``gap`` ...); None: the
            first.
        dataset: that was fitted, which a fit needs; a diagnosis has its own.

    Raises:
        InputError: there is no such figure, or the dataset is missing.
    """
    from skincal.calibrate import Outcome
    from skincal.report import diagnosis as diagnosis_report
    from skincal.report import fit as fit_report
    from skincal.report.dataset import dataset_figure

    if isinstance(result, Dataset):
        return dataset_figure(result)
    if isinstance(result, Outcome):
        if dataset is None:
            raise InputError([Problem("plot", "the dataset that was fitted", "none", "give dataset=")])
        figures = {one.stem: one.draw for one in fit_report.SECTIONS}
        return _chosen(figures, figure)(result.result, dataset)
    figures = {stem: draw for stem, _, _, draw in diagnosis_report.SECTIONS}
    return _chosen(figures, figure)(result, dataset or result.observed.dataset)


def _chosen(figures: dict[str, Callable[..., Figure]], name: str | None) -> Callable[..., Figure]:
    if name is None:
        return next(iter(figures.values()))
    if name not in figures:
        raise InputError([Problem("plot", f"one of the figures {', '.join(figures)}", f'"{name}"')])
    return figures[name]


def _bars(shown: bool) -> AbstractContextManager[Callable[[str, int, int], None]]:
    return stage_bars() if shown else nullcontext(_silent)


def _silent(stage: str, done: int, total: int) -> None:
    del stage, done, total
