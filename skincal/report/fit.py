"""The report of a fit: one self-contained page, with its figures as files."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from markupsafe import escape
from matplotlib.figure import Figure

from skincal.calibration import Calibration
from skincal.dataset import Dataset
from skincal.fitting.result import FitResult
from skincal.report.fit_bound import bound_story
from skincal.report.fit_draws import draws_figure
from skincal.report.fit_images import images_figure
from skincal.report.fit_residuals import residuals_figure, scatter_figure
from skincal.report.fit_slack import slack_figure
from skincal.report.fit_story import (
    effect_rows,
    headline,
    parameter_rows,
    press_rows,
    provenance_rows,
    scatter_rows,
    verdict,
)
from skincal.report.fit_valley import valley_figure
from skincal.report.page import Picture, picture, rendered

PAGE = "report.html"


@dataclass(frozen=True)
class _Section:
    """A figure of the report."""

    stem: str
    title: str
    caption: str
    draw: Callable[[FitResult, Dataset], Figure]


SECTIONS = (
    _Section(
        "valley",
        "The valley over the macro variables",
        "Diagonal: the paper's loss along one variable. Below: over two of them. It is always minimised over all other "
        "variables, with the scale by least squares and every press placed by its normalised image. The ratios of two "
        "or three taxels do not determine a position, so this loss stays above the noise and its valley is wide. By "
        "default the fit continues with the absolute images, which are more informative; the draws (black) show its "
        "valley.",
        lambda result, _: valley_figure(result),
    ),
    _Section(
        "draws",
        "Draws from the valley",
        "Draws of all five parameters, as written by `export-dr --joint`. Lines: best value and interval of each. "
        "Above the diagonal, their correlations: where one is large, the box of the intervals is wider than the draws.",
        lambda result, _: draws_figure(result),
    ),
    _Section(
        "images",
        "Measured against simulated images",
        "Three maps per press: measured, simulated, difference; u to the right, v up, taxels as on the patch. "
        "Green frame: a match within the noise. Red, thick frame: a worse match. Presses that were left out as "
        "outliers come first; their differences may exceed the scale.",
        images_figure,
    ),
    _Section(
        "slack",
        "Contact positions",
        "Left: from the measured (black) to the estimated position (red), on the patch at its best pose. Right: the "
        "same shifts from one point. Numbers are press numbers. A mean far from zero, or shifts that crowd at "
        "the bound, mean that the position errors exceed the slack.",
        slack_figure,
    ),
    _Section(
        "residuals",
        "Residuals",
        "The position of every press is fitted, so small residuals alone prove little; look for patterns. By taxel: "
        "unequal gains. Against force or value: a nonlinear law. Over the session: drift. A taxel of a press is "
        "included where it is measured or simulated above the noise; the others are left out here, but count in "
        "the rmse of a press.",
        residuals_figure,
    ),
    _Section(
        "scatter",
        "Measured against simulated values",
        "Left: all taxels above the noise. Right: their differences. These are smaller than the "
        "curves suggest if a press touches so few taxels that its position explains most of them; the estimated "
        "scatter allows for that.",
        lambda result, _: scatter_figure(result),
    ),
)


def write_fit_report(
    result: FitResult, calibration: Calibration, dataset: Dataset, folder: str | Path
) -> None:
    """Write ``report.html`` and its figures (``valley.png`` ...) into a folder.

    The page contains its figures and needs nothing from elsewhere; it can be sent as a single file.

    Args:
        result: the fit.
        calibration: the calibration of the fit, for the provenance.
        dataset: the dataset that was fitted.
        folder: an existing folder; files of the same names are replaced.
    """
    folder, unit = Path(folder), dataset.meta.sensor.unit
    figures = [
        picture(section.draw(result, dataset), section.stem, section.title, section.caption, folder, unit)
        for section in SECTIONS
    ]
    (folder / PAGE).write_text(_page(result, calibration, dataset, figures), encoding="utf-8")


def _page(result: FitResult, calibration: Calibration, dataset: Dataset, figures: list[Picture]) -> str:
    fine, words = headline(result)
    return rendered(
        "fit.html",
        dataset.meta.sensor.unit,
        name=escape(calibration.provenance.dataset or (dataset.folder.name if dataset.folder else "dataset")),
        source=escape(dataset.meta.source),
        fine=fine,
        headline=words,
        verdict=verdict(result),
        findings=sorted(calibration.findings, key=lambda finding: finding.severity != "warning"),
        effects=effect_rows(calibration),
        best={name: f"{value:.5g}" for name, value in calibration.model.best().items()},
        rmse=f"{calibration.loss.mse_counts2**0.5:.3g}",
        parameters=parameter_rows(result),
        bound=bound_story(result, calibration),
        scatter=scatter_rows(result),
        figures=figures,
        presses=press_rows(result, dataset),
        provenance=provenance_rows(calibration),
    )
