"""The report of a fit: one page that holds everything, and its pictures beside it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

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
    """One figure of the report."""

    stem: str
    title: str
    caption: str
    draw: Callable[[FitResult, Dataset], Figure]


SECTIONS = (
    _Section(
        "valley",
        "The valley over the macro variables",
        "Diagonal: the paper's loss along one variable. Below: over two of them. It is always the least over all other "
        "variables, with the scale by least squares and every press placed by its normalised image. The ratios of two "
        "or three taxels do not tell a whole place, so this loss stays above the noise and its valley is wide. By "
        "default the fit goes on with the absolute images, which tell more; the draws (black) are the valley it ends "
        "with.",
        lambda result, _: valley_figure(result),
    ),
    _Section(
        "draws",
        "Draws from the valley",
        "Draws of all five parameters, as `export-dr --joint` hands them on. Lines: best value and interval of each. "
        "Above the diagonal their correlations: where one is large, the box of the intervals is wider than the cloud.",
        lambda result, _: draws_figure(result),
    ),
    _Section(
        "images",
        "Measured against simulated images",
        "Three maps a press: measured, simulated, difference; u to the right, v up, taxels as they lie on the patch. "
        "Green frame: matched as well as the noise lets expect. Red, thick frame: not. Presses that were left out as "
        "glitches stand first; what they differ by may lie beyond the scale.",
        images_figure,
    ),
    _Section(
        "slack",
        "Contact positions",
        "Left: from the measured (black) to the estimated position (red), on the patch at its best pose. Right: the "
        "same shifts from one point. Numbers are those of the presses. A mean far from zero, or shifts that crowd at "
        "the bound, mean that the rig is off by more than its slack allows.",
        slack_figure,
    ),
    _Section(
        "residuals",
        "Residuals",
        "Every press may choose its position, so small residuals alone prove little; a pattern does. By taxel: unequal "
        "gains. Against force or value: a law that is not linear. Over the session: drift. A taxel of a press takes "
        "part where it is measured or simulated above the noise; what noise alone lights is left out, but counts in "
        "the rmse of a press, which is over all taxels.",
        residuals_figure,
    ),
    _Section(
        "scatter",
        "Measured against simulated values",
        "Left: all taxels that a press lights above the noise. Right: their differences. They lie closer than the "
        "curves where a press touches so few taxels that its position explains most of them; the scatter that was "
        "found allows for that.",
        lambda result, _: scatter_figure(result),
    ),
)


def write_fit_report(
    result: FitResult, calibration: Calibration, dataset: Dataset, folder: str | Path
) -> None:
    """Write ``report.html`` and its pictures (``valley.png`` ...) into a folder.

    The page holds its pictures itself and needs nothing from elsewhere; it can be sent to somebody as one file.

    Args:
        result: the fit.
        calibration: what it became; gives the provenance.
        dataset: that was fitted.
        folder: an existing folder; files of the same names are replaced.
    """
    folder = Path(folder)
    figures = [
        picture(section.draw(result, dataset), section.stem, section.title, section.caption, folder)
        for section in SECTIONS
    ]
    (folder / PAGE).write_text(_page(result, calibration, dataset, figures), encoding="utf-8")


def _page(result: FitResult, calibration: Calibration, dataset: Dataset, figures: list[Picture]) -> str:
    fine, words = headline(result)
    return rendered(
        "fit.html",
        name=calibration.provenance.dataset or (dataset.folder.name if dataset.folder else "dataset"),
        source=dataset.meta.source,
        fine=fine,
        headline=words,
        verdict=verdict(result),
        findings=sorted(result.findings, key=lambda finding: finding.severity != "warning"),
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
