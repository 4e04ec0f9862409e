"""``skincal fit``: calibrate the simulated skin against a dataset."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Callable, Generator
from contextlib import contextmanager
from dataclasses import replace
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import typer

from skincal.cli.common import (
    DatasetArgument,
    ForceOption,
    JsonOption,
    OutOption,
    SchedulerOption,
    SeedOption,
    WorkersOption,
    example,
    print_json,
    say,
    warn,
)
from skincal.cli.fit_ranges import Pair, searched
from skincal.cli.interrupt import Ended
from skincal.fitting.fit_options import PAPER_BOUND_COUNTS2, STEPS, FitOptions, GridSteps
from skincal.progress import stage_bars
from skincal.units import deg, rad

if TYPE_CHECKING:
    from skincal.calibrate import Method, Way
    from skincal.calibration import Calibration
    from skincal.dataset import Dataset
    from skincal.errors import InputError

EPILOG = example("skincal fit data/paper-like --out cal", "skincal fit run --out cal --bound paper --json")


def _range(name: str, what: str) -> typer.models.OptionInfo:
    return typer.Option(name, help=f"Low and high of {what}, instead of those of [mount].")


def _step(
    name: str, least: float, what: str, of: Callable[[GridSteps], float], most: float | None = None
) -> typer.models.OptionInfo:
    fast, general, nlopt = (f"{of(STEPS[method]):g}" for method in ("fast", "general", "nlopt"))
    shown = f"{fast}; {general} with general; {nlopt} with nlopt"
    return typer.Option(name, min=least, max=most, help=what, show_default=shown)


def fit(
    dataset: DatasetArgument,
    out: OutOption,
    y_range_mm: Annotated[Pair | None, _range("--y-range-mm", "y [mm]")] = None,
    beta_range_deg: Annotated[Pair | None, _range("--beta-range-deg", "beta [°] (cylinder, mesh)")] = None,
    x_range_mm: Annotated[Pair | None, _range("--x-range-mm", "x [mm] (plane)")] = None,
    alpha_range_deg: Annotated[Pair | None, _range("--alpha-range-deg", "alpha [°]")] = None,
    elasticity_range: Annotated[
        Pair | None,
        typer.Option("--e-range-mpa-per-m", help="Low and high of E [MPa/m].", show_default="100 2000"),
    ] = None,
    method: Annotated[
        str,
        typer.Option(
            "--method",
            help="`fast`: tables, for surfaces that look the same everywhere; `general`: tables of the skin model, "
            "press by press, for any geometry; `nlopt`: general, after a grid of the skin model itself, slow; `auto`: "
            "`fast` where possible, else `general`.",
        ),
    ] = "auto",
    y_step_mm: Annotated[
        float | None, _step("--y-step-mm", 0.01, "Grid step of y [mm].", lambda s: 1e3 * s.y_m)
    ] = None,
    arc_step_mm: Annotated[
        float | None,
        _step("--arc-step-mm", 0.01, "Grid step of beta as arc, or of x [mm].", lambda s: 1e3 * s.across_m),
    ] = None,
    alpha_step_deg: Annotated[
        float | None, _step("--alpha-step-deg", 0.05, "Grid step of alpha [°].", lambda s: deg(s.alpha_rad))
    ] = None,
    e_count: Annotated[
        int | None, _step("--e-count", 2, "Grid values of E, log-spaced.", lambda s: s.elasticities, 10_000)
    ] = None,
    active_counts: Annotated[
        float | None,
        typer.Option(
            "--active-counts",
            min=0.0,
            help="Value above rest that makes a taxel active; default 2 % of the converter's range, or less where "
            "the signals are small, and at least five times the noise.",
        ),
    ] = None,
    min_active: Annotated[
        int, typer.Option("--min-active", min=1, help="Presses with fewer active taxels are not used.")
    ] = 2,
    bound: Annotated[
        str,
        typer.Option(
            "--bound",
            help="Bound of the valley: `noise`, by the noise of the data; `paper`, 25 counts² of "
            "loss on the grid; or a number of counts².",
        ),
    ] = "noise",
    level: Annotated[
        float, typer.Option("--level", min=0.5, max=0.999, help="Posterior probability inside each interval.")
    ] = 0.98,
    draws: Annotated[int, typer.Option("--draws", min=10, help="Number of posterior draws to write.")] = 2000,
    per_taxel: Annotated[bool, typer.Option("--per-taxel", help="Also fit a scale for every taxel.")] = False,
    effects: Annotated[
        Path | None,
        typer.Option(
            "--effects",
            help="A calibration of this sensor whose effects are refitted, along with pose, E and S; not under uniform "
            "pressure, where a fit finds only scales.",
        ),
    ] = None,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    seed: SeedOption = 0,
    report: Annotated[bool, typer.Option(help="Write the report: HTML page and pictures.")] = True,
    as_json: JsonOption = False,
    force: ForceOption = False,
) -> None:
    """Fit pose, elasticity and scale of the skin model to the presses of a dataset.

    Writes a calibration: best parameters, intervals, the evaluated grid, posterior draws, the slack of every press, and
    a report. An interrupted fit continues when the same command is given again.
    """
    from skincal.calibrate import calibrate, choose_way
    from skincal.calibrate.dataset_fit import why_dropped
    from skincal.calibration import write_calibration
    from skincal.dataset import read_dataset
    from skincal.dataset.uniform_pressure import uniform_pressure
    from skincal.files import refuse_existing
    from skincal.units import in_unit

    options = FitOptions(
        active_counts=active_counts, min_active=min_active, bound_counts2=_bound(bound), level=level, draws=draws,
        per_taxel=per_taxel,
    )  # fmt: skip
    inputs = [dataset] if effects is None else [dataset, effects]
    refuse_existing(out, *inputs, force=force, marker="calibration.toml")
    data = read_dataset(dataset)
    warn(data.warnings)
    if uniform_pressure(data):
        if effects is not None:
            raise _no_effects_here(effects, dataset)
        say(
            "skincal: uniform pressure: fitting the scale of each taxel; the data do not determine pose and elasticity"
        )
        _fit_uniform(data, out, options, seed, report=report, as_json=as_json, force=force)
        return
    known = None if effects is None else _with_effects(effects, data)
    way = choose_way(data, cast("Method", method))
    if way.method != "fast":
        say(
            f"skincal: fitting with the skin model itself, press by press; this takes a minute or more: {way.why}"
        )
    options = replace(options, steps=_steps(way, y_step_mm, arc_step_mm, alpha_step_deg, e_count))
    box = searched(data, y_range_mm, x_range_mm, beta_range_deg, alpha_range_deg, elasticity_range)
    checkpoint = out.parent / f".{out.name}.fit"
    with _resumable(checkpoint), stage_bars() as reporter:
        outcome = calibrate(
            data,
            options=options,
            box=box,
            seed=seed,
            workers=workers,
            scheduler=scheduler,
            checkpoint=checkpoint,
            command=shlex.join(["skincal", *sys.argv[1:]]),
            method=way.method,
            progress=reporter,
        )
        if known is not None:
            from skincal.diagnosis.workflow import refitted_effects

            reporter("effects", 0, 1)
            both = refitted_effects(data, outcome.calibration, known, seed)
            outcome = replace(outcome, calibration=both)
            reporter("effects", 1, 1)
        reporter("report", 0, 1)

        def write_extras(folder: Path) -> None:
            if report:
                from skincal.report.fit import write_fit_report

                write_fit_report(outcome.result, outcome.calibration, data, folder)

        write_calibration(outcome.calibration, out, force=force, beside=write_extras)
        reporter("report", 1, 1)
    if outcome.resumed:
        turns = "1 turn" if outcome.resumed == 1 else f"{outcome.resumed} turns"
        say(f"{turns} of the grid taken from an interrupted run")
    about = in_unit(why_dropped(outcome.result.problem), data.meta.sensor.unit)
    _told(outcome.calibration, f"{len(outcome.result.problem)} presses", about, out, report, as_json)


def _no_effects_here(effects: Path, dataset: Path) -> InputError:
    from skincal.errors import InputError, Problem

    expected = (
        f"a dataset of presses; under uniform pressure, as in {dataset}, a fit finds scales and nothing else"
    )
    fix = "leave --effects out; `skincal diagnose` searches for the effects of such a session"
    return InputError([Problem("--effects", expected, str(effects), fix)])


def _fit_uniform(
    data: Dataset, out: Path, options: FitOptions, seed: int, *, report: bool, as_json: bool, force: bool
) -> None:
    """Fit the session of a pressure chamber."""
    from skincal.calibrate import calibrate_uniform
    from skincal.calibration import write_calibration

    outcome = calibrate_uniform(
        data,
        active_counts=options.active_counts,
        level=options.level,
        seed=seed,
        command=" ".join(["skincal", *sys.argv[1:]]),
    )

    def write_extras(folder: Path) -> None:
        if report:
            from skincal.report.fit_uniform import write_uniform_report

            write_uniform_report(outcome, data, folder)

    write_calibration(outcome.calibration, out, force=force, beside=write_extras)
    presses = outcome.calibration.loss.presses_used
    _told(outcome.calibration, f"{presses} presses of uniform pressure", "", out, report, as_json)


def _with_effects(folder: Path, data: Dataset) -> Calibration:
    """Return a calibration with effects; refuse one without effects, or of another sensor, before the fit begins."""
    from skincal.calibration import read_calibration
    from skincal.calibration.matching import check_same_sensor
    from skincal.errors import InputError, Problem

    found = read_calibration(folder)
    if not found.effects:
        text = "a calibration with effects, such as skincal diagnose writes"
        raise InputError([Problem(f"--effects: {folder}", text, "one without; leave --effects out")])
    check_same_sensor(found, data)
    return found


def _steps(
    way: Way, y_mm: float | None, arc_mm: float | None, alpha_deg: float | None, e_count: int | None
) -> GridSteps:
    """Return the given grid steps, else those of the method."""
    default = STEPS[way.method]
    return GridSteps(
        default.across_m if arc_mm is None else arc_mm * 1e-3,
        default.y_m if y_mm is None else y_mm * 1e-3,
        default.alpha_rad if alpha_deg is None else rad(alpha_deg),
        default.elasticities if e_count is None else e_count,
    )


def _bound(text: str) -> float | None:
    from skincal.errors import InputError, Problem

    if text == "noise":
        return None
    if text == "paper":
        return PAPER_BOUND_COUNTS2
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0 < value < float("inf"):
        raise InputError([Problem("--bound", "`noise`, `paper` or a positive number [counts²]", text)])
    return value


@contextmanager
def _resumable(checkpoint: Path) -> Generator[None]:
    """Say, when a fit ends early, where its grid is saved and how to continue.

    A checkpoint that would only fail again is removed: that of a fit that cannot be done or ends in an internal error,
    and a folder without a grid.
    """
    from skincal.calibrate.checkpoint import Checkpoint
    from skincal.errors import WorkError

    kept = Checkpoint(checkpoint, "")
    try:
        yield
    except (WorkError, ValueError, ArithmeticError):
        kept.remove()
        raise
    except BaseException as error:
        if not any(checkpoint.glob("turn-*.npz")):
            kept.remove()
            raise
        what = "interrupted. The" if isinstance(error, KeyboardInterrupt) else "the fit ended early; its"
        say(f"skincal: {what} grid so far is saved in {checkpoint}; give the same command again to continue.")
        if isinstance(error, KeyboardInterrupt):
            raise Ended(130) from None
        raise
    kept.remove()


def _as_json(calibration: Calibration, out: Path) -> dict[str, object]:
    return {
        "loss_mse_counts2": calibration.loss.mse_counts2,
        "valley_mse_counts2": calibration.loss.valley_mse_counts2,
        "presses_used": calibration.loss.presses_used,
        "best": calibration.model.best(),
        "intervals": {name: list(calibration.intervals[name]) for name in calibration.model.best()},
        "rest_counts": calibration.model.rest_counts,
        "rest_interval_counts": calibration.intervals.get("rest_counts"),
        "draws": _draws(calibration),
        "findings": [finding.as_json() for finding in calibration.findings],
        "effects": [effect.name for effect in calibration.effects],
        "calibration": str(out),
    }


def _draws(calibration: Calibration) -> dict[str, int] | None:
    """Return the number of posterior draws that are written, and their effective number."""
    effective = calibration.loss.extra.get("effective_draws")
    if calibration.draws is None or effective is None:
        return None
    kept = len(next(iter(calibration.draws.values())))
    return {"kept": kept, "effective": min(kept, round(effective))}


def _told(calibration: Calibration, presses: str, about: str, out: Path, report: bool, as_json: bool) -> None:
    """Print a calibration as JSON, or as a table."""
    if as_json:
        print_json(_as_json(calibration, out))
        return
    from rich.console import Console
    from rich.table import Table

    console, rmse = Console(), calibration.loss.mse_counts2**0.5
    table = Table(title=f"{presses}, rmse {rmse:.3g} {calibration.sensor.unit_label} per taxel")
    for column in ("parameter", "best", "low", "high"):
        table.add_column(column, justify="left" if column == "parameter" else "right")
    best = calibration.model.best()
    if calibration.model.rest_counts is not None:
        best["rest_counts"] = calibration.model.rest_counts
    for name, (low, high) in calibration.intervals.items():
        ends = (f"{low:.5g}", f"{high:.5g}") if isfinite(high - low) else ("unknown", "unknown")
        table.add_row(name, f"{best[name]:.5g}", *ends)
    for effect in calibration.effects:
        for name, (low, high) in effect.intervals.items():
            ends = [f"{end:.4g}" for end in (low, high) if isinstance(end, float | int)]
            value = effect.parameters[name]
            if len(ends) == 2 and isinstance(value, float | int):
                table.add_row(f"{effect.name}: {name}", f"{value:.4g}", *ends)
    console.print(table)
    if about:
        say(about)
    for finding in calibration.findings:
        say(f"{finding.severity}: {finding.text} {finding.advice}".rstrip())
    say(f"calibration: {out}" + (f"   report: {out / 'report.html'}" if report else ""))
