"""``skincal fit``: calibrate the simulated skin against a dataset."""

from __future__ import annotations

from collections.abc import Callable, Generator
from contextlib import contextmanager, suppress
from dataclasses import replace
from importlib import import_module
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

from skincal.cli import options
from skincal.cli.interrupt import AGAIN, resumable
from skincal.cli.options import Pair, command_line, example, option
from skincal.cli.terminal import answer, calibration_line, say, table, warn
from skincal.errors import InputError, Problem, input_error
from skincal.fitting.fit_options import PAPER_BOUND_COUNTS2, STEPS, FitOptions, GridSteps
from skincal.progress import stage_bars
from skincal.units import deg, rad

if TYPE_CHECKING:
    from skincal.calibrate import Method
    from skincal.calibration import Calibration
    from skincal.dataset import Dataset
    from skincal.fitting.fit_options import SearchBox

EPILOG = example("skincal fit data/paper-like --out cal", "skincal fit run --out cal --bound paper --json")

LARGEST_E_MPA_PER_M = 1e6
"""Far stiffer than any skin: 0.1 mm of a hard plastic has 3e7 Pa / 1e-4 m = 3e5 MPa/m."""

NARROW = 0.01
"""A range below this part of the mount's, which overlaps it only when read in metres, is taken to be in metres."""


def _range(what: str) -> Any:
    return option(f"Low and high of {what}, instead of those of [mount].")


def _step(least: float, what: str, of: Callable[[GridSteps], float], most: float = 1000.0) -> Any:
    fast, general, nlopt = (f"{of(STEPS[method]):g}" for method in ("fast", "general", "nlopt"))
    shown = f"{fast}; {general} with general; {nlopt} with nlopt"
    return option(what, min=least, max=most, show_default=shown)


MIN_ACTIVE = (
    "Presses with fewer active taxels are not used; default 2, or 1 where fewer than 16 presses have 2."
)
METHOD = (
    "`fast`: tables, for surfaces that look the same everywhere; `general`: tables of the skin model, press by press, "
    "for any geometry; `nlopt`: general, after a grid of the skin model itself, slow; `auto`: `fast` where possible, "
    "else `general`."
)
ACTIVE = (
    "Value above rest that makes a taxel active; default 2 % of the converter's range, or less where the signals are "
    "small, and at least five times the noise."
)
BOUND = (
    "Bound of the valley: `noise`, by the noise of the data; `paper`, 25 counts² of loss on the grid; or a number of "
    "counts²."
)
EFFECTS = (
    "A calibration of this sensor whose effects are refitted, along with pose, E and S; not under uniform pressure, "
    "where a fit finds only scales."
)
SCHEDULER = "Use the workers of a Dask cluster, tcp://HOST:8786, instead of processes on this machine."
UNIFORM = "skincal: uniform pressure: fitting the scale of each taxel; the data do not determine pose and elasticity"
PRESS_BY_PRESS = "skincal: fitting with the skin model itself, press by press; this takes a minute or more"
_E_RANGE = "Low and high of E [MPa/m]."


def fit(
    dataset: options.Dataset,
    out: options.Out,
    y_range_mm: Annotated[Pair | None, _range("y [mm]")] = None,
    beta_range_deg: Annotated[Pair | None, _range("beta [°] (cylinder, mesh)")] = None,
    x_range_mm: Annotated[Pair | None, _range("x [mm] (plane)")] = None,
    alpha_range_deg: Annotated[Pair | None, _range("alpha [°]")] = None,
    e_range_mpa_per_m: Annotated[Pair | None, option(_E_RANGE, show_default="100 2000")] = None,
    method: Annotated[str, option(METHOD)] = "auto",
    y_step_mm: Annotated[float | None, _step(0.01, "Grid step of y [mm].", lambda s: 1e3 * s.y_m)] = None,
    arc_step_mm: Annotated[
        float | None, _step(0.01, "Grid step of beta as arc, or of x [mm].", lambda s: 1e3 * s.across_m)
    ] = None,
    alpha_step_deg: Annotated[
        float | None, _step(0.05, "Grid step of alpha [°].", lambda s: deg(s.alpha_rad))
    ] = None,
    e_count: Annotated[
        int | None, _step(2, "Grid values of E, log-spaced.", lambda s: s.elasticities, 10_000)
    ] = None,
    active_counts: Annotated[float | None, option(ACTIVE, min=0.0)] = None,
    min_active: Annotated[int | None, option(MIN_ACTIVE, min=1, max=16_384)] = None,
    bound: Annotated[str, option(BOUND)] = "noise",
    level: Annotated[
        float, option("Posterior probability inside each interval.", min=0.5, max=0.999)
    ] = FitOptions().level,
    draws: Annotated[int, option("Number of posterior draws to write.", min=10, max=1_000_000)] = 2000,
    per_taxel: Annotated[bool, option("Also fit a scale for every taxel.", "--per-taxel")] = False,
    effects: Annotated[Path | None, option(EFFECTS)] = None,
    workers: options.Workers = None,
    scheduler: Annotated[str | None, option(SCHEDULER, metavar="ADDRESS")] = None,
    seed: options.Seed = 0,
    report: options.Report = True,
    as_json: options.Json = False,
    force: options.Force = False,
) -> None:
    """Fit pose, elasticity and scale of the skin model to the presses of a dataset.

    Writes a calibration: best parameters, intervals, the evaluated grid, posterior draws, the slack of every press, and
    a report. An interrupted fit continues when the same command is given again.
    """
    from skincal.files import refuse_existing
    from skincal.units import in_unit
    from skincal.workers.processes import mapper, rare_collections

    bound_counts2 = _bound(bound)
    refuse_existing(out, dataset, effects, force=force, marker="calibration.toml")
    # Workers start while this process imports and reads.
    with rare_collections(), mapper(workers, scheduler) as spread, resumable(lambda: ""):
        here = map if scheduler is not None else spread  # a cluster need not have what draws
        first = "skincal.report.fit_images" if report else "skincal.calibrate"
        here(import_module, [first, "skincal.fitting.wiring"])
        from skincal import api
        from skincal.calibrate import Outcome, choose_way
        from skincal.calibrate.dataset_fit import why_dropped
        from skincal.calibration import write_calibration
        from skincal.dataset import read_dataset
        from skincal.dataset.uniform_pressure import uniform_pressure

        data = read_dataset(dataset)
        warn(data.warnings)
        box, steps, known = None, None, None
        if uniform_pressure(data):
            if effects is not None:
                expected = (
                    f"a dataset of presses; under uniform pressure, as in {dataset}, a fit finds scales"
                )
                fix = "leave --effects out; `skincal diagnose` searches for the effects of such a session"
                raise input_error("--effects", f"{expected} and nothing else", effects, fix)
            say(UNIFORM)
        else:
            known = None if effects is None else _with_effects(effects, data)
            way = choose_way(data, cast("Method", method))
            if way.method != "fast":
                say(f"{PRESS_BY_PRESS}: {way.why}")
            given = {
                "across_m": (arc_step_mm, 1e-3), "y_m": (y_step_mm, 1e-3),
                "alpha_rad": (alpha_step_deg, rad(1.0)), "elasticities": (e_count, 1),
            }  # fmt: skip
            own = {name: value * unit for name, (value, unit) in given.items() if value is not None}
            steps = replace(STEPS[way.method], **own)
            box = search_box(data, y_range_mm, x_range_mm, beta_range_deg, alpha_range_deg, e_range_mpa_per_m)
        settings = FitOptions(
            active_counts=active_counts, min_active=min_active, bound_counts2=bound_counts2, level=level, draws=draws,
            per_taxel=per_taxel, steps=steps,
        )  # fmt: skip
        with _resumable(out) as checkpoint, stage_bars() as progress:
            found = api.fit(
                data, options=settings, box=box, method=cast("Method", method), effects=known, seed=seed,
                workers=spread, checkpoint=checkpoint, command=command_line(), progress=progress,
            )  # fmt: skip
            progress("report", 0, 1)

            def write_extras(folder: Path) -> None:
                if not report:
                    return
                if isinstance(found, Outcome):
                    from skincal.report.fit import write_fit_report

                    write_fit_report(found.result, found.calibration, data, folder, here)
                else:
                    from skincal.report.fit_uniform import write_uniform_report

                    write_uniform_report(found, data, folder)

            write_calibration(found.calibration, out, force=force, beside=write_extras)
            progress("report", 1, 1)
    presses, about = f"{found.calibration.loss.presses_used} presses of uniform pressure", ""
    if isinstance(found, Outcome):
        presses = f"{len(found.result.problem)} presses"
        about = in_unit(why_dropped(found.result.problem), data.meta.sensor.unit)
        if found.resumed:
            rotations = len(found.result.grid.grid.alpha_rad)
            say(f"{found.resumed} of {rotations} sensor rotations were already computed")
    rmse = f"{found.calibration.loss.mse_counts2**0.5:.3g} {data.meta.sensor.unit_label} per taxel"
    cal = found.calibration
    findings = [f"{one.severity}: {one.text} {one.advice}".rstrip() for one in cal.findings]
    then = "\n".join([*([about] if about else []), *findings, calibration_line(out, report)])
    answer(as_json, _as_json(cal, out), f"{presses}, rmse {rmse}", _parameters(cal), then=then)


def _with_effects(folder: Path, data: Dataset) -> Calibration:
    """Return a calibration with effects; refuse one without effects, or of another sensor, before the fit begins."""
    from skincal.calibration import read_calibration
    from skincal.calibration.matching import check_same_sensor

    found = read_calibration(folder)
    if not found.effects:
        expected = "a calibration with effects, such as skincal diagnose writes"
        raise input_error(f"--effects: {folder}", expected, "one without; leave --effects out")
    check_same_sensor(found, data)
    return found


def _bound(text: str) -> float | None:
    if text in ("noise", "paper"):
        return None if text == "noise" else PAPER_BOUND_COUNTS2
    from skincal.bounded import number_in

    value = -1.0
    with suppress(ValueError):
        value = number_in(text, float)
    if value <= 0:
        raise input_error("--bound", "`noise`, `paper` or a positive number [counts²]", text)
    return value


def search_box(
    data: Dataset,
    y_mm: Pair | None,
    x_mm: Pair | None,
    beta_deg: Pair | None,
    alpha_deg: Pair | None,
    elasticity_mpa_per_m: Pair | None,
) -> SearchBox:
    """Return the ranges to search: those given, else those of the dataset's ``[mount]``.

    Raises:
        InputError: a range that the surface does not have, in another unit, or from high to low.
    """
    from skincal.calibrate import search_box

    mount, surface, stiff = data.meta.mount, data.meta.surface, elasticity_mpa_per_m
    own, other = (x_mm, beta_deg) if surface.is_plane else (beta_deg, x_mm)
    if other is not None:
        right, wrong_one = ("--x-range-mm", "--beta-range-deg")[:: 1 if surface.is_plane else -1]
        raise input_error(wrong_one, f"no such range on a {surface.kind}", "one", f"Give {right} instead.")
    if stiff is not None and max(stiff) > LARGEST_E_MPA_PER_M:
        expected = f"low and high [MPa/m], at most {LARGEST_E_MPA_PER_M:g}"
        fix = "Are they in Pa/m? Divide by 1e6."
        raise input_error("--e-range-mpa-per-m", expected, f"{stiff[0]:g} and {stiff[1]:g}", fix)
    given = {
        "--y-range-mm": y_mm, "--x-range-mm": x_mm, "--beta-range-deg": beta_deg, "--alpha-range-deg": alpha_deg,
        "--e-range-mpa-per-m": elasticity_mpa_per_m,
    }  # fmt: skip
    wrong = [
        Problem(name, "low below high", f"{pair[0]:g} and {pair[1]:g}")
        for name, pair in given.items()
        if pair is not None and not pair[0] < pair[1]
    ]
    if wrong:
        raise InputError(wrong)
    return search_box(
        data,
        y_m=_metres("--y-range-mm", y_mm, mount.y_range_m),
        across=_metres("--x-range-mm", own, mount.x_range_m) if surface.is_plane else own,
        alpha_deg=alpha_deg,
        elasticity_pa_per_m=None if stiff is None else (stiff[0] * 1e6, stiff[1] * 1e6),
    )


def _metres(name: str, range_mm: Pair | None, mount_m: Pair | None) -> Pair | None:
    """Return a range given in millimetres in metres, unless it makes sense only in metres."""
    if range_mm is None:
        return None
    low, high = range_mm
    if mount_m is not None:
        least, most = mount_m
        if low <= most and high >= least and abs(high - low) < NARROW * 1e3 * (most - least):
            expected = f"low and high [mm] ([mount] has {1e3 * least:g} to {1e3 * most:g})"
            fix = "Are they in metres? Multiply by 1000."
            raise input_error(name, expected, f"{low:g} and {high:g}", fix)
    return low * 1e-3, high * 1e-3


@contextmanager
def _resumable(out: Path) -> Generator[Path]:
    """Keep the evaluated grid of a fit that ends early, unless it would only fail again; yield its folder."""
    from skincal.calibrate.checkpoint import Checkpoint, checkpoint_folder
    from skincal.errors import WorkError

    checkpoint = checkpoint_folder(out)

    def has_grid() -> bool:
        return any(checkpoint.glob("turn-*.npz"))

    kept, again = Checkpoint(checkpoint, ""), False
    saved = f"The grid so far is saved in {checkpoint}; {AGAIN}."
    try:
        with resumable(lambda: saved if again and has_grid() else ""):
            try:
                yield checkpoint
            except BaseException as error:
                again = not isinstance(error, WorkError | ValueError | ArithmeticError)
                raise
    finally:
        if not (again and has_grid()):
            kept.remove()


def _as_json(calibration: Calibration, out: Path) -> dict[str, object]:
    loss, effective, draws = calibration.loss, calibration.loss.extra.get("effective_draws"), None
    if calibration.draws is not None and effective is not None:
        kept = len(next(iter(calibration.draws.values())))
        draws = {"kept": kept, "effective": min(kept, round(effective))}
    return {
        "loss_mse_counts2": loss.mse_counts2,
        "valley_mse_counts2": loss.valley_mse_counts2,
        "presses_used": loss.presses_used,
        "best": calibration.model.best(),
        "intervals": {name: list(calibration.intervals[name]) for name in calibration.model.best()},
        "rest_counts": calibration.model.rest_counts,
        "rest_interval_counts": calibration.intervals.get("rest_counts"),
        "draws": draws,
        "findings": [finding.as_json() for finding in calibration.findings],
        "effects": [effect.name for effect in calibration.effects],
        "calibration": str(out),
    }


def _parameters(calibration: Calibration) -> Any:
    best: dict[str, Any] = {**calibration.model.best(), "rest_counts": calibration.model.rest_counts}
    rows: list[tuple[str, ...]] = []
    for name, (low, high) in calibration.intervals.items():
        ends = (f"{low:.5g}", f"{high:.5g}") if isfinite(high - low) else ("unknown", "unknown")
        rows.append((name, f"{best[name]:.5g}", *ends))
    for effect in calibration.effects:
        for name, (low, high) in effect.intervals.items():
            numbers = [x for x in (effect.parameters[name], low, high) if isinstance(x, float | int)]
            if len(numbers) == 3:
                rows.append((f"{effect.name}: {name}", *(f"{x:.4g}" for x in numbers)))
    return table(("parameter", "best", "low", "high"), rows, right=True)
