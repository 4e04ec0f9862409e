"""The report of a fit says what the fit found, and every figure can be drawn for every form of result."""

from __future__ import annotations

import base64
import logging
import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from skincal.calibration import Calibration, Effect, Finding, Loss, ModelParameters, Provenance
from skincal.dataset import Dataset, MountSpec, PositionSpec, Presses, SurfaceSpec
from skincal.dataset.placement import patch_coordinates
from skincal.fitting.alternatives import Nonlinearity
from skincal.fitting.fit_options import SearchBox
from skincal.fitting.grid import MacroGrid
from skincal.fitting.observe import Readout
from skincal.fitting.problem import PressTable, Rig, build_problem
from skincal.fitting.result import FitFinding, FitResult, GridResult, PressFit, Sigmas
from skincal.model import Contacts, Patch, SensorPose, Skin, SkinParameters
from skincal.report.fit import FIGURES, quantities, why_unused, with_digits, write_fit_report
from skincal.report.fit_images import chosen_presses, images_figure, left_out
from skincal.report.fit_residuals import Residuals, residuals_figure
from skincal.report.fit_slack import measured_uv_m, slack_figure
from skincal.report.fit_valley import valley_figure
from skincal.report.style import GREEN, RED
from skincal.workers.processes import mapper
from tests.conftest import RADIUS_M, make_session

BEST = {
    "across_m": 0.4e-3,
    "y_m": 0.0241,
    "alpha_rad": -0.07,
    "elasticity_pa_per_m": 3.5e8,
    "scale_per_n": 62.0,
}
HALF = {"across_m": 0.3e-3, "y_m": 0.25e-3, "alpha_rad": 0.03, "elasticity_pa_per_m": 2e7, "scale_per_n": 0.6}
"""Half widths of the intervals."""

Fitted = tuple[FitResult, Dataset, Calibration]


def make_fit(kind: str = "cylinder", presses: int = 9, seed: int = 3) -> Fitted:
    """A session of the model itself, and the result that a good fit of it has; the grid is a smooth bowl."""
    generator = np.random.default_rng(seed)
    plane = kind == "plane"
    meta = replace(make_session().meta, source='rig <script>alert("2")</script>')
    if plane:
        mount = MountSpec(0.0235, 0.0, (0.0195, 0.0275), (-20.0, 20.0), x_m=0.0, x_range_m=(-0.0024, 0.0024))
        meta = replace(meta, surface=SurfaceSpec("plane"), mount=mount)
    slack = generator.normal(0.0, 0.5e-3, (presses, 2))
    true = BEST["across_m"], BEST["y_m"]
    across, along = (centre + generator.uniform(-5e-3, 5e-3, presses) for centre in true)
    force = generator.uniform(1.0, 4.0, presses)
    shell = Dataset(meta, Presses(np.arange(presses), np.zeros((presses, 3)), force, np.zeros((presses, 16))))
    surface = shell.surface()
    values = _skin(shell, plane).values(
        shell.indenter(), _contacts(shell, across + slack[:, 0], along + slack[:, 1], force)
    )
    counts = np.clip(values + generator.normal(0.0, 0.2, values.shape), 0, 255)
    dataset = Dataset(meta, Presses(10 + np.arange(presses), _points(shell, across, along), force, counts))
    rig = Rig(dataset.layout(), surface, (dataset.indenter(),), Readout(0, 255, True), 0.001, 0.002)
    indenter = np.zeros(presses, dtype=np.intp)
    problem = build_problem(rig, PressTable(np.arange(presses), across, along, force, counts, indenter))
    uv = patch_coordinates(surface, _pose(plane), _points(shell, across + slack[:, 0], along + slack[:, 1]))
    simulated = values[problem.rows]
    rmse = np.sqrt(((simulated - problem.values) ** 2).mean(axis=1))
    fit = PressFit(
        slack[problem.rows], uv[problem.rows], problem.values, simulated, rmse,
        np.ones(len(problem), dtype=bool), np.zeros(len(problem)),
    )  # fmt: skip
    draws = np.stack([generator.normal(BEST[n], HALF[n] / 2.3, 500) for n in BEST], axis=1)
    result = FitResult(
        best=BEST,
        intervals={n: (BEST[n] - HALF[n], BEST[n] + HALF[n]) for n in BEST},
        mse_counts2=float((rmse**2).mean()),
        valley_mse_counts2=0.09,
        bound="noise",
        draws=draws,
        sigmas=Sigmas(0.6e-3, 0.004, 0.2, 0.01, 0.01, 1e-4),
        law_spread_m=0.1e-3,
        law_rise=0.0,
        nonlinearity=Nonlinearity(),
        effective_draws=400.0,
        force_low=0.0,
        misfit_low=0.0,
        rest_counts=0.0,
        rest_interval=(0.0, 0.0),
        grid=_bowl(),
        presses=fit,
        problem=problem,
        box=SearchBox((-2.4e-3, 2.4e-3), (0.0195, 0.0275), (-0.35, 0.35)),
        scale_per_taxel_per_n=None,
        dead_taxels=np.zeros(16, dtype=bool),
        findings=(),
    )
    return result, dataset, _calibration(dataset, plane)


def _pose(plane: bool) -> SensorPose:
    across_m = BEST["across_m"]
    across = {"x_m": across_m} if plane else {"beta_rad": across_m / RADIUS_M}
    return SensorPose(BEST["y_m"], BEST["alpha_rad"], **across)


def _points(shell: Dataset, across: np.ndarray, along: np.ndarray) -> np.ndarray:
    top = np.tile([0.0, 0.0, 0.0 if shell.meta.surface.kind == "plane" else RADIUS_M], (len(across), 1))
    return shell.surface().offset(top, across, along)


def _contacts(shell: Dataset, across: np.ndarray, along: np.ndarray, force: np.ndarray) -> Contacts:
    points = _points(shell, across, along)
    return Contacts(points, shell.surface().normal_at(points), force)


def _skin(shell: Dataset, plane: bool) -> Skin:
    patch = Patch.build(shell.surface(), shell.layout(), _pose(plane))
    return Skin(patch, SkinParameters(BEST["elasticity_pa_per_m"], BEST["scale_per_n"]))


def _bowl() -> GridResult:
    grid = MacroGrid(
        np.linspace(-2.4e-3, 2.4e-3, 6),
        np.linspace(0.0195, 0.0275, 9),
        np.linspace(-0.35, 0.35, 7),
        np.linspace(np.log(1e8), np.log(2e9), 8),
    )
    alpha, log_e, across, y = np.meshgrid(
        grid.alpha_rad, grid.log_elasticity, grid.across_m, grid.y_m, indexing="ij"
    )
    mse = (
        0.05
        + 20 * (alpha / 0.35 + 0.2) ** 2
        + 9 * (log_e - np.log(3.5e8)) ** 2
        + 40 * (across / 2.4e-3) ** 2
        + 100 * ((y - 0.0241) / 4e-3) ** 2
    )
    return GridResult(grid, mse, np.full_like(mse, 62.0), np.full_like(mse, 5e-4), mse < 0, 1.2)


def _calibration(dataset: Dataset, plane: bool) -> Calibration:
    across = {"x_m": 4e-4} if plane else {"beta_deg": 2.0}
    return Calibration.of_dataset(
        dataset,
        model=ModelParameters(0.0241, -4.0, 3.5e8, 62.0, **across),
        intervals={},
        loss=Loss(0.04, 0.09, 12),
        provenance=Provenance(
            "ab12", "thumb", "0.1.0", "skincal fit thumb --out <cal>", 7, options={"level": 0.98}
        ),
    )


@pytest.fixture(scope="module")
def fitted() -> Fitted:
    return make_fit()


@pytest.fixture(scope="module")
def figure(fitted: Fitted) -> Callable[[str], Figure]:
    """The figures of the fit, each made once."""
    return cache(lambda stem: FIGURES[stem](*fitted[:2]))


@pytest.fixture(scope="module")
def folder(fitted: Fitted, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("report")
    write_fit_report(fitted[0], fitted[2], fitted[1], path)
    return path


class _Page(HTMLParser):
    """Tags in order, whether all are closed, the text, and every address."""

    VOID = ("meta", "img")

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[str] = []
        self.addresses: list[str] = []
        self.text = ""
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.text += " " * (tag in ("td", "th"))
        self.addresses += [v or "" for k, v in attrs if k in ("src", "href", "srcset", "data")]
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if "style" not in self.open:
            self.text += data


@pytest.fixture
def words(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., str]:
    """The text of a page without its figures, with single spaces."""
    monkeypatch.setattr("skincal.report.fit.FIGURES", {})

    def read(result: FitResult, dataset: Dataset, calibration: Calibration) -> str:
        write_fit_report(result, calibration, dataset, tmp_path)
        page = _Page((tmp_path / "report.html").read_text(encoding="utf-8"))
        assert page.open == [] and "b" not in page.tags
        assert not re.search(r"\bnan\b", page.text)
        return " ".join(page.text.split())

    return read


Words = Callable[..., str]


def test_the_page_holds_its_pictures_and_needs_nothing_else(folder: Path) -> None:
    text = (folder / "report.html").read_text(encoding="utf-8")
    page = _Page(text)
    assert page.open == []
    assert {file.name for file in folder.iterdir()} == {"report.html", *(f"{stem}.png" for stem in FIGURES)}
    assert len(page.addresses) == len(FIGURES)
    for address, stem in zip(page.addresses, FIGURES, strict=True):
        head, _, data = address.partition(",")
        assert head == "data:image/png;base64"
        assert base64.b64decode(data) == (folder / f"{stem}.png").read_bytes()
    assert not {"script", "link", "iframe", "object"} & set(page.tags)
    without = re.sub(r"data:image/png;base64,[^\"]*", "", text)
    assert "http" not in without
    assert "url(" not in without
    assert "@import" not in without


def test_the_page_says_what_was_found(folder: Path, fitted: Fitted) -> None:
    page = _Page((folder / "report.html").read_text(encoding="utf-8"))
    assert "Fit report: thumb" in page.text
    assert 'rig <script>alert("2")</script>' in page.text, "text from files is no markup"
    assert "skincal fit thumb --out <cal>" in page.text
    assert "Nothing needs attention" in page.text
    assert "24.10 mm (23.85 to 24.35)" in page.text
    assert "350 MPa/m (330 to 370)" in page.text
    assert "nan" not in page.text.split()
    for number in fitted[1].presses.press:
        assert str(number) in page.text


def test_page_of_a_fit_with_effects_names_its_model(fitted: Fitted, words: Words) -> None:
    result, data, calibration = fitted
    assert "to which all figures" not in words(*fitted)
    loop = Effect("hysteresis", {"height": 0.21, "width": 1.5}, {"height": (0.19, 0.23)})
    gains = Effect("taxel_gain", {"gain": [0.9, 1.1, 1.0]})
    page = words(result, data, replace(calibration, effects=(loop, gains)))
    assert "base model, to which all figures" in page
    assert "hysteresis height 0.21 0.19 0.23" in page and "taxel_gain gain 0.9 to 1.1" in page


def test_the_report_is_reproducible(folder: Path, fitted: Fitted, tmp_path: Path) -> None:
    with mapper(2) as spread:  # figures drawn by several processes are the same
        write_fit_report(fitted[0], fitted[2], fitted[1], tmp_path, spread)
    for file in folder.iterdir():
        assert file.read_bytes() == (tmp_path / file.name).read_bytes(), file.name


def test_what_needs_attention_comes_with_advice(fitted: Fitted, words: Words) -> None:
    result, dataset, calibration = fitted
    findings = (
        FitFinding("a", "info", "A note."),
        FitFinding("b", "warning", "E & <alpha>.", "Press <b> `a<b>c` elsewhere."),
    )
    intervals = {**result.intervals, "elasticity_pa_per_m": (-np.inf, np.inf)}
    changed = replace(result, findings=findings, intervals=intervals, law_spread_m=0.0)
    own = tuple(Finding(f.code, f.severity, f.text, f.advice) for f in findings)
    page = words(changed, dataset, replace(calibration, findings=own))
    assert "One thing needs attention before you rely on this calibration." in page
    assert page.index("E & <alpha>.") < page.index("A note."), "warnings come first"
    assert "Press <b> a<b>c elsewhere." in page, "backticks become code, markup does not work"
    assert "not identified" in page and "spread pressure sideways" not in page


def test_undetermined_calibration_is_not_to_be_used(fitted: Fitted, words: Words) -> None:
    warned = (FitFinding("few_draws", "warning", "Too few draws."),)
    page = words(replace(fitted[0], findings=warned, effective_draws=3.0), *fitted[1:])
    assert "Do not use this calibration: the data do not determine its parameters." in page
    assert "no interval is given" in page and "Intervals hold" not in page


def test_sentences_of_the_verdict(fitted: Fitted, words: Words) -> None:
    result, *others = fitted
    page = words(*fitted)
    assert "the noise explains all of it" in page and "its own scale" not in page
    assert "central 98 %" in page and "98 % of the draws leave a loss below 0.09 counts²" in page
    as_good = int((result.grid.mse_counts2 <= 1.2).sum())
    assert "loss of 1.2 counts² at the best point" in page and f"{as_good or 'none'} of its points" in page
    scales = np.full(16, 62.0)
    scales[[3, 9]] = 70.0, 55.0
    status = tuple("no positive force" if k < 2 else s for k, s in enumerate(result.problem.status))
    changed = replace(
        result,
        scale_per_taxel_per_n=scales,
        problem=replace(result.problem, status=status),
        sigmas=Sigmas(2e-3, 0.004, 3.0, 0.01, 0.01, 1e-4),
    )
    page = words(changed, *others)
    assert "from 55 of taxel (2, 1) to 70 of taxel (0, 3) 1/N" in page
    assert ("no positive force", 2) in why_unused(changed) and "2 with no positive force" in page
    assert "the model lacks something" in page
    assert "contact position, each direction 1 mm 2 mm larger than declared" in page
    assert "more than noise explains" in page
    everything = replace(result, problem=replace(result.problem, status=("used",) * len(status)))
    assert f"All {len(status)} presses were used." in words(everything, *others)
    grid = replace(result.grid, in_valley=result.grid.mse_counts2 <= 25.0)
    page = words(replace(result, bound="fixed", valley_mse_counts2=25.0, grid=grid), *others)
    assert "below 25 counts² (rmse 5 counts)" in page
    assert f"{int(grid.in_valley.sum()):,} of {grid.grid.combinations:,}" in page


def test_table_of_intervals(fitted: Fitted, words: Words) -> None:
    page = words(*fitted)
    assert "y [mm] 24.10 23.85 24.35 19.5 to 27.5 6.2 %" in page and "any (found by least squares)" in page
    y, _, _, e, _ = quantities(fitted[0])
    assert y.bar_percent[0] == pytest.approx(100 * (23.85 - 19.5) / 8)
    # E is searched by its logarithm, so its share is that of the logarithms.
    assert e.bar_percent[1] == pytest.approx(100 * np.log(370 / 330) / np.log(20))


def test_a_plane_has_x_and_a_cylinder_beta(fitted: Fitted) -> None:
    beta = quantities(fitted[0])[1]
    assert (beta.label, beta.unit) == ("beta", "°")
    assert beta.best == pytest.approx(np.degrees(BEST["across_m"] / RADIUS_M))
    x = quantities(make_fit("plane")[0])[1]
    assert (x.label, x.unit, x.best) == ("x", "mm", pytest.approx(0.4))


@pytest.mark.parametrize(
    ("value", "width", "text"),
    [
        (24.2961, 0.50, "24.30"),
        (-3.907, 2.6, "−3.9"),
        (332.7, 53.0, "333"),
        (-0.0001, 0.5, "0.00"),
        (np.inf, 1.0, "∞"),
        (-np.inf, 1.0, "−∞"),
        (12.3456, 0.0, "12.35"),
    ],
)
def test_numbers_have_as_many_digits_as_are_known(value: float, width: float, text: str) -> None:
    assert with_digits(value, width) == text


def test_presses_lie_where_the_pose_puts_them(fitted: Fitted) -> None:
    """Turning the measured slack into the patch's axes takes the measured to the estimated position."""
    result, dataset, _ = fitted
    cos, sin = np.cos(BEST["alpha_rad"]), np.sin(BEST["alpha_rad"])
    turned = result.presses.slack_m @ np.array([[cos, -sin], [sin, cos]])
    measured = measured_uv_m(result, dataset)[result.problem.rows]
    np.testing.assert_allclose(measured + turned, result.presses.uv_m, atol=1e-9)


def test_worst_and_best_are_among_those_shown() -> None:
    rmse = np.random.default_rng(0).uniform(size=200)
    chosen = chosen_presses(rmse, most=48)
    assert len(chosen) == len(set(chosen.tolist())) == 30
    order = np.argsort(-rmse)
    assert set(order[:10]) <= set(chosen)
    assert set(order[-5:]) <= set(chosen)
    assert (np.diff(rmse[chosen]) <= 0).all(), "the worst come first"
    assert sorted(chosen_presses(rmse[:48], most=48).tolist()) == list(range(48))


def test_residuals_are_of_touched_taxels_only(fitted: Fitted) -> None:
    result = fitted[0]
    found, problem = Residuals.of(result), result.problem
    assert found.touched.sum() == np.isfinite(found.difference).sum() < found.touched.size
    assert not found.touched[~problem.lit & (result.presses.simulated < 1)].any()
    shown = np.maximum(result.presses.simulated, result.presses.observed)
    assert found.level_counts >= 4 * problem.noise_sigma_counts
    np.testing.assert_array_equal(found.touched, (problem.weight > 0) & (shown >= found.level_counts))
    high = replace(problem, saturated=np.ones_like(problem.saturated))
    assert np.nanmax(Residuals.of(replace(result, problem=high)).difference) == 0.0, (
        "at least this much is no error"
    )


def test_what_only_noise_lights_has_no_residual(fitted: Fitted) -> None:
    result = fitted[0]
    k, j = np.argwhere(~problem_lit(result))[0]
    lit, observed = result.problem.lit.copy(), result.presses.observed.copy()
    lit[k, j], observed[k, j] = True, 0.55
    changed = replace(
        result, problem=replace(result.problem, lit=lit), presses=replace(result.presses, observed=observed)
    )
    assert not Residuals.of(changed).touched[k, j]
    title = residuals_figure(changed, fitted[1]).get_suptitle()
    assert "above noise" in title and f"≥ {Residuals.of(changed).level_counts:.2g} counts" in title


def problem_lit(result: FitResult) -> np.ndarray:
    return result.problem.lit | (result.presses.simulated > 0)


def titled(figure: Figure, start: str) -> object:
    (found,) = [axes for axes in figure.axes if axes.get_title(loc="left").startswith(start)]
    return found


def test_the_valley_is_the_least_over_the_other_variables(
    fitted: Fitted, figure: Callable[[str], Figure]
) -> None:
    result = fitted[0]
    valley = figure("valley")
    rmse = np.sqrt(result.grid.mse_counts2)
    for label, axis in {"y": 3, "beta": 2, "alpha": 0, "E": 1}.items():
        line = titled(valley, f"along {label}").lines[0]  # type: ignore[attr-defined]
        expected = rmse.min(axis=tuple(a for a in range(4) if a != axis))
        np.testing.assert_allclose(line.get_ydata(), expected)
    assert sum(axes.get_ylabel() == "rmse [counts]" for axes in valley.axes) == 4
    assert len([axes for axes in valley.axes if axes.get_xlabel()]) >= 4


def test_levels_in_the_valley_are_of_the_loss_that_is_drawn(fitted: Fitted) -> None:
    def levels(result: FitResult) -> list[float]:
        axes = titled(valley_figure(result), "along y")
        return [float(line.get_ydata()[0]) for line in axes.lines[1:-1]]  # type: ignore[attr-defined]

    assert levels(fitted[0]) == pytest.approx([1.2**0.5, 5.0]), (
        "the bound of the absolute images is none of them"
    )
    fixed = replace(fixed_bound(fitted[0]), valley_mse_counts2=9.0)
    assert levels(fixed) == pytest.approx([3.0, 5.0])


def test_frames_tell_good_from_bad(fitted: Fitted) -> None:
    result, dataset, _ = fitted
    figure = images_figure(with_bad(result, 0, 3), dataset)
    colours = [
        p.get_edgecolor()
        for axes in figure.axes
        for p in axes.patches
        if isinstance(p, Rectangle) and not p.get_fill()
    ]
    assert colours.count(to_rgba(RED)) == 2
    assert colours.count(to_rgba(GREEN)) == len(result.problem) - 2
    words = [text.get_text() for axes in figure.axes for text in axes.texts]
    assert sum(word.startswith("bad: ") for word in words) == 2
    assert (
        f"press {dataset.presses.press[result.problem.rows[0]]}, {result.problem.force_n[0]:.3g} N" in words
    )


def test_glitches_are_shown_with_what_the_skin_says(fitted: Fitted) -> None:
    result, dataset, _ = fitted
    worst = int(np.argmax(result.problem.force_n))
    without = part(result, np.arange(len(result.problem)) != worst, "glitch: odd")
    (press,) = left_out(without, dataset)
    assert press.row == result.problem.rows[worst]
    np.testing.assert_allclose(press.simulated, result.presses.simulated[worst], atol=1.5)
    assert press.rmse_counts < 1.0, "it is no glitch in truth"
    words = [text.get_text() for axes in images_figure(without, dataset).axes for text in axes.texts]
    assert words[0] == f"press {dataset.presses.press[press.row]}, {dataset.presses.force_n[press.row]:.3g} N"
    assert words[1].startswith("left out: rmse")
    assert left_out(result, dataset) == []
    # A tilt moves the load as a slack does, so it shows where there is none.
    held = replace(dataset, meta=replace(dataset.meta, position=PositionSpec(0.001, 0.0)))
    tilted = np.tile([0.3, 0.0, 0.954], (len(dataset.presses), 1))
    (one,) = left_out(without, held)
    (other,) = left_out(without, replace(held, presses=replace(dataset.presses, normals=tilted)))
    assert np.abs(other.simulated - one.simulated).max() > 0.5, "a measured normal counts"


def test_maps_are_the_images(fitted: Fitted, figure: Callable[[str], Figure]) -> None:
    result = fitted[0]
    # One collection, and one scale of colours, for all images, one for all differences; the worst press first.
    images, differences = figure("images").axes[0].collections
    taxels, worst = result.problem.rig.layout.taxels, int(np.argmax(result.presses.rmse_counts))
    observed, simulated = result.presses.observed[worst], result.presses.simulated[worst]
    np.testing.assert_allclose(images.get_array()[:taxels], observed)
    np.testing.assert_allclose(images.get_array()[taxels : 2 * taxels], simulated)
    np.testing.assert_allclose(differences.get_array()[:taxels], simulated - observed)
    lefts = [
        c.get_paths()[k].vertices[:, 0].min() for c, k in ((images, 0), (images, taxels), (differences, 0))
    ]
    assert lefts == sorted(lefts)


def test_slack_is_drawn_from_measured_to_estimated(fitted: Fitted, figure: Callable[[str], Figure]) -> None:
    result = fitted[0]
    axes = titled(figure("slack"), "On the patch")
    (lines,) = axes.collections  # type: ignore[attr-defined]
    ends = np.array([segment[1] for segment in lines.get_segments()])
    np.testing.assert_allclose(ends, 1e3 * result.presses.uv_m)


def with_bad(result: FitResult, *bad: int) -> FitResult:
    """Some presses match badly."""
    good = ~np.isin(np.arange(len(result.problem)), bad)
    return replace(result, presses=replace(result.presses, good=good))


def one_bad_and_unread(result: FitResult) -> FitResult:
    dead = np.arange(16) == 5
    return replace(with_bad(result, 0), problem=result.problem.without_taxels(dead), dead_taxels=dead)


def part(result: FitResult, keep: np.ndarray, why: str) -> FitResult:
    """Only some presses were used."""
    fit = PressFit(*(array[keep] for array in vars(result.presses).values()))
    return replace(result, problem=result.problem.subset(keep, why), presses=fit)


def fixed_bound(result: FitResult) -> FitResult:
    grid = replace(result.grid, in_valley=result.grid.mse_counts2 <= 25.0)
    chosen = np.random.default_rng(0).integers(0, 3, (200, 5))
    draws = np.array([BEST[n] for n in result.intervals]) * (1 + 0.2 * chosen)
    return replace(result, bound="fixed", valley_mse_counts2=25.0, grid=grid, draws=draws)


def one_draw(result: FitResult) -> FitResult:
    return replace(result, draws=result.draws[:1])


def nothing_known(result: FitResult) -> FitResult:
    wide = result.draws.copy()
    wide[:, 3] = np.geomspace(1e8, 2e9, len(wide))
    return replace(result, draws=wide, intervals=dict.fromkeys(result.intervals, (-np.inf, np.inf)))


def without_a_search(result: FitResult) -> FitResult:
    """Alpha and y were held; the grid has one value of each."""
    old = result.grid
    mse = old.mse_counts2[:1, :, :, :1]
    grid = replace(old.grid, alpha_rad=old.grid.alpha_rad[:1], y_m=old.grid.y_m[:1])
    box = replace(result.box, alpha_rad=(0.1, 0.1), y_m=(0.02, 0.02))
    return replace(result, grid=GridResult(grid, mse, mse, mse, mse < 0, 1.2), box=box)


def nothing_searched(result: FitResult) -> FitResult:
    old, one = result.grid.grid, np.ones((1, 1, 1, 1))
    grid = MacroGrid(old.across_m[:1], old.y_m[:1], old.alpha_rad[:1], old.log_elasticity[:1])
    return replace(result, grid=GridResult(grid, one, one, one, one < 0, 1.0))


def few_presses(result: FitResult) -> FitResult:
    return part(result, np.arange(len(result.problem)) < 3, "left out")


def unknown_positions(result: FitResult) -> FitResult:
    rig = replace(result.problem.rig, position_sigma_m=np.inf, slack_m=np.inf)
    return replace(result, problem=replace(result.problem, rig=rig))


CHANGES: dict[Callable[[FitResult], FitResult], str] = {
    one_bad_and_unread: "images slack residuals scatter",
    few_presses: "images slack residuals scatter",
    unknown_positions: "slack",
    fixed_bound: "valley draws",
    nothing_known: "valley draws",
    one_draw: "draws",
    without_a_search: "valley",
    nothing_searched: "valley",
}
"""Odd results, and the figures in which they matter."""


@pytest.mark.parametrize(("change", "stems"), CHANGES.items(), ids=lambda x: getattr(x, "__name__", ""))
def test_odd_results_are_drawn_and_described_too(
    fitted: Fitted,
    change: Callable[[FitResult], FitResult],
    stems: str,
    caplog: pytest.LogCaptureFixture,
    words: Words,
) -> None:
    result, dataset, calibration = fitted
    changed = change(result)
    with caplog.at_level(logging.WARNING):
        for stem in stems.split():
            FIGURES[stem](changed, dataset).draw_without_rendering()
    assert not caplog.records
    assert words(changed, dataset, calibration)


def test_a_fit_on_a_plane_is_drawn_and_described(words: Words) -> None:
    result, dataset, calibration = make_fit("plane")
    for stem in ("valley", "draws"):
        labels = [axes.get_xlabel() for axes in FIGURES[stem](result, dataset).axes]
        assert "x [mm]" in labels and "beta [°]" not in labels
    slack_figure(result, dataset).draw_without_rendering()
    page = words(result, dataset, calibration)
    assert "x [mm]" in page and "beta" not in page


@pytest.mark.parametrize("stem", sorted({*FIGURES} - {"images"}))
def test_panels_do_not_overlap(figure: Callable[[str], Figure], stem: str) -> None:
    figure(stem).draw_without_rendering()
    boxes = [axes.get_tightbbox() for axes in figure(stem).axes if axes.get_visible() and axes.get_xlabel()]
    for i, one in enumerate(boxes):
        for other in boxes[i + 1 :]:
            assert not one.padded(-3).overlaps(other.padded(-3))
