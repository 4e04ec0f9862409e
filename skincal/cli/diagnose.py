"""``skincal diagnose``: find where simulation and data disagree, and add the missing effects to the model."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from skincal.cli.common import (
    CalibrationArgument,
    DatasetArgument,
    ForceOption,
    JsonOption,
    OutOption,
    SeedOption,
    example,
    plain,
    print_json,
    say,
    warn,
)
from skincal.cli.hand import BeyondLimitsOption, DriverOptionsOption

if TYPE_CHECKING:
    from collections.abc import Callable

    from skincal.diagnosis.diagnosis import Diagnosis

EPILOG = example(
    "skincal diagnose run cal --out cal-2",
    "skincal diagnose run cal --out cal-2 --collect --driver sim --seed 7",
)


def diagnose(
    dataset: DatasetArgument,
    calibration: CalibrationArgument,
    out: OutOption,
    thorough: Annotated[bool, typer.Option("--thorough", help="Five times as many null sessions.")] = False,
    seed: SeedOption = 0,
    workers: Annotated[
        int | None, typer.Option("--workers", min=1, hidden=True, help="Ignored: one process is enough.")
    ] = None,
    cache: Annotated[
        bool, typer.Option(hidden=True, help="Ignored: no stage takes long enough to cache.")
    ] = True,
    collect: Annotated[
        bool,
        typer.Option(
            "--collect",
            help="Where an effect has several names, make the presses that tell, up to 12, and diagnose again.",
        ),
    ] = False,
    driver: Annotated[
        str, typer.Option("--driver", help="With --collect: driver of the hand that the dataset comes from.")
    ] = "sim",
    effect: Annotated[
        list[str] | None,
        typer.Option(
            "--effect",
            metavar="NAME=STRENGTH",
            help="With --collect: effect of the simulated skin. May be repeated.",
            show_default=False,
        ),
    ] = None,
    hand: Annotated[
        str | None,
        typer.Option(
            "--hand", help="With --collect: name of the hand, or its hand.toml.", show_default=False
        ),
    ] = None,
    driver_option: DriverOptionsOption = None,
    beyond_limits: BeyondLimitsOption = False,
    report: Annotated[bool, typer.Option(help="Write the report: HTML page and pictures.")] = True,
    as_json: JsonOption = False,
    force: ForceOption = False,
) -> None:
    """Find where simulation and data disagree, name what is missing, and add it to the model.

    The verdict is "none" (nothing missing can be shown), "effects" (named, with their parameters) or "unknown"
    (something is missing that none of the known effects explains). NEWCAL is a calibration like any other; CAL is not
    changed.

    With --collect the hand makes further presses where an effect has several names, at most 12, until each has one;
    NEWCAL/session is the dataset with all presses. An interrupted run continues when the same command is given again.
    """
    del workers, cache  # accepted so that commands written for earlier versions still work
    from skincal.calibration import read_calibration, write_calibration
    from skincal.collect import write_plan
    from skincal.dataset import read_dataset
    from skincal.diagnosis.next_presses import PLAN_FILE
    from skincal.diagnosis.summary import collected, summary
    from skincal.diagnosis.workflow import diagnose as diagnosed
    from skincal.files import refuse_existing
    from skincal.inference.constants import CONSTANTS

    refuse_existing(out, dataset, calibration, force=force, marker="calibration.toml")
    data, cal = read_dataset(dataset), read_calibration(calibration)
    rounds = None
    if collect:
        from skincal.cli.diagnose_collect import Rounds

        rounds = Rounds.of(out, data, driver, seed, effect, hand, driver_option, beyond_limits=beyond_limits)
    said = [str(problem) for problem in (*data.warnings, *cal.warnings)]
    warn((*data.warnings, *cal.warnings))
    sessions = CONSTANTS.null_sessions * (5 if thorough else 1)
    settled = None
    if rounds is not None:
        from skincal.cli.interrupt import moving
        from skincal.diagnosis.settle import settle

        # No bar for the stages: the hand's own is shown while it presses.
        with moving(rounds.kept):
            settled = settle(data, cal, rounds.press, seed, lambda _: None, sessions, say)
        say(settled.reason)
    with _stages() as heard:
        found = diagnosed(data, cal, seed, heard, sessions) if settled is None else settled.diagnosis
        data = data if settled is None else settled.dataset
        heard("report")
        command = shlex.join(["skincal", *sys.argv[1:]])
        now = datetime.now(UTC).replace(microsecond=0)
        provenance = replace(found.calibration.provenance, command=command, seed=seed, time=now)
        found = replace(found, calibration=replace(found.calibration, provenance=provenance))
        plan = None if found.next_plan is None else str(out / PLAN_FILE)
        made = {} if settled is None else {"collected": collected(settled)}
        content = plain(
            {**summary(found), **made, "next_presses_plan": plan, "calibration": str(out), "warnings": said}
        )

        def write_extras(folder: Path) -> None:
            from skincal.report.diagnosis import write_diagnosis_report

            write_diagnosis_report(found, data, folder, content, pages=report)
            if found.next_plan is not None:
                write_plan(found.next_plan, folder / PLAN_FILE)
            if rounds is not None and settled is not None:
                rounds.keep_in(folder, settled.made, settled.rounds)

        write_calibration(found.calibration, out, force=force, beside=write_extras)
        if rounds is not None:
            rounds.done()
    if as_json:
        print_json(content)
        return
    _tell(found, out, report)


@contextmanager
def _stages() -> Generator[Callable[[str], None]]:
    """Yield a callback that shows the stage and the elapsed time on standard error, line by line without a terminal."""
    from rich.console import Console
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
    from rich.table import Column

    console = Console(stderr=True)
    if not console.is_terminal:
        yield say
        return
    # Truncate a long stage name, not the time.
    stage = TextColumn("{task.description}", markup=False, table_column=Column(no_wrap=True, ratio=1))
    columns = SpinnerColumn(), TimeElapsedColumn(table_column=Column(min_width=7)), stage
    with Progress(*columns, console=console, transient=True, expand=True) as shown:
        task = shown.add_task("reading", total=None)
        yield lambda name: shown.update(task, description=name)


def _tell(found: Diagnosis, out: Path, report: bool) -> None:
    from skincal.report.diagnosis_words import verdict_lines

    for line in verdict_lines(found):
        typer.echo(line)
    say(f"calibration: {out}" + (f"   report: {out / 'report.html'}" if report else ""))
