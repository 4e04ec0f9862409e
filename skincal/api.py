"""The main job from a notebook or a script, one function a verb; ``import skincal`` gives these names."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from skincal.calibration import Calibration, read_calibration, skin_of, write_calibration
from skincal.dataset import Dataset, read_dataset, write_dataset
from skincal.errors import input_error
from skincal.model import Skin
from skincal.progress import stage_bars

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from skincal.calibrate import Method, Outcome, UniformOutcome
    from skincal.diagnosis.diagnosis import Diagnosis
    from skincal.fitting.fit_options import FitOptions, SearchBox
    from skincal.fitting.tasks import Mapper
    from skincal.prediction import Prediction
    from skincal.ranges import Ranges

Progress = Callable[[str, int, int], None]
"""Callback of a stage, how much of it is done, and of how much."""

__all__ = [
    "Skin", "diagnose", "export_ranges", "fit", "plot", "predict", "read_calibration", "read_dataset",
    "skin_of", "write_calibration", "write_dataset",
]  # fmt: skip


def fit(
    dataset: Dataset,
    *,
    options: FitOptions | None = None,
    box: SearchBox | None = None,
    method: Method = "auto",
    effects: Calibration | None = None,
    seed: int = 0,
    workers: int | Mapper | None = None,
    scheduler: str | None = None,
    checkpoint: Path | None = None,
    command: str = "",
    progress: bool | Progress = False,
) -> Outcome | UniformOutcome:
    """Fit pose, elasticity and scale to a dataset, as ``skincal fit`` does.

    Args:
        dataset: of :func:`read_dataset`.
        options: settings; None for the defaults.
        box: ranges to search; None for those of the dataset's ``[mount]``.
        method: ``auto``, ``fast``, ``general`` or ``nlopt``.
        effects: a calibration whose effects are refitted along with pose, elasticity and scale.
        seed: of the draws.
        workers: processes; None for one a core; or an open mapper of them. The result does not depend on it.
        scheduler: address of a Dask scheduler whose workers are used instead.
        checkpoint: folder for the evaluated grid until the fit is done; None for none.
        command: command line, for the provenance.
        progress: whether bars are shown, or a callback (stage, done, total).

    Returns:
        The fit; its ``calibration`` is what the other functions take. Uniform pressure determines the scale of each
        taxel, and neither pose nor elasticity.

    Raises:
        WorkError: the presses do not allow a fit; says why and what to do.
    """
    from skincal.calibrate import calibrate, calibrate_uniform
    from skincal.dataset.uniform_pressure import uniform_pressure
    from skincal.fitting.fit_options import FitOptions

    if uniform_pressure(dataset):
        own = options or FitOptions()
        return calibrate_uniform(
            dataset, active_counts=own.active_counts, level=own.level, seed=seed, command=command
        )
    with _bars(progress) as update:
        found = calibrate(
            dataset, options=options, box=box, seed=seed, workers=workers, scheduler=scheduler, checkpoint=checkpoint,
            command=command, method=method, progress=update,
        )  # fmt: skip
        if effects is None:
            return found
        from skincal.diagnosis.workflow import refitted_effects
        from skincal.workers.processes import one_blas_thread

        update("effects", 0, 1)
        with one_blas_thread():
            both = refitted_effects(dataset, found.calibration, effects, seed)
        update("effects", 1, 1)
        return replace(found, calibration=both)


def predict(
    calibration: Calibration, dataset: Dataset, *, slack: bool = False, progress: bool | Progress = False
) -> Prediction:
    """Predict the images of a dataset's presses, as ``skincal predict`` does.

    Args:
        calibration: the skin, effects included.
        dataset: contacts to predict.
        slack: whether each press is moved to the best position within its slack.
        progress: whether bars are shown, or a callback (stage, done, total).

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
    workers: int | Mapper | None = None,
    progress: bool = False,
) -> Diagnosis:
    """Find what a calibrated simulation lacks against a dataset, as ``skincal diagnose`` does.

    Args:
        dataset: the session.
        calibration: of the same sensor.
        seed: of all randomness.
        workers: processes; None for one a core; or an open mapper of them. The result does not depend on it.
        progress: whether each stage is printed.

    Returns:
        The diagnosis; its ``calibration`` has what was named.

    Raises:
        InputError: the calibration is of another sensor.
        WorkError: too few presses.
    """
    from skincal.diagnosis.workflow import diagnose as run
    from skincal.workers.processes import mapper, one_blas_thread

    with one_blas_thread(), mapper(workers) as spread:
        return run(
            dataset,
            calibration,
            seed,
            (lambda stage: print(stage, flush=True)) if progress else (lambda _: None),
            mapper=spread,
        )


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
            raise input_error("plot", "the dataset that was fitted", "none", "give dataset=")
        return _chosen(fit_report.FIGURES, figure)(result.result, dataset)
    return _chosen(diagnosis_report.FIGURES, figure)(result, dataset or result.observed.dataset)


def _chosen(figures: Mapping[str, Callable[..., Figure]], name: str | None) -> Callable[..., Figure]:
    if name is None:
        return next(iter(figures.values()))
    if name not in figures:
        raise input_error("plot", f"one of the figures {', '.join(figures)}", f'"{name}"')
    return figures[name]


def _bars(progress: bool | Progress) -> AbstractContextManager[Progress]:
    if progress is True:
        return stage_bars()
    return nullcontext(progress or (lambda _stage, _done, _total: None))
