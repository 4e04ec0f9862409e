"""``skincal diagnose``: find where simulation and data disagree, and add the missing effects to the model."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Annotated

from skincal.cli import options
from skincal.cli.collect import press, rig_of
from skincal.cli.interrupt import AGAIN, moving, resumable
from skincal.cli.options import command_line, example, option
from skincal.cli.terminal import answer, calibration_line, plain, say, warn
from skincal.progress import stage_shown

EPILOG = example(
    "skincal diagnose run cal --out cal-2",
    "skincal diagnose run cal --out cal-2 --collect --driver sim --seed 7",
)

COLLECT = (
    "Where an effect has several names, make presses that distinguish them, up to 12, and diagnose again."
)


def diagnose(
    dataset: options.Dataset,
    calibration: options.Calibration,
    out: options.Out,
    thorough: Annotated[bool, option("Five times as many null sessions.", "--thorough")] = False,
    seed: options.Seed = 0,
    workers: options.Workers = None,
    cache: Annotated[bool, option("Ignored: no stage takes long enough to cache.", hidden=True)] = True,
    collect: Annotated[bool, option(COLLECT, "--collect")] = False,
    driver: options.Driver = "sim",
    effect: options.Effects = None,
    hand: options.Hand = None,
    driver_option: options.DriverOptions = None,
    beyond_limits: options.BeyondLimits = False,
    report: options.Report = True,
    as_json: options.Json = False,
    force: options.Force = False,
) -> None:
    """Find where simulation and data disagree, name what is missing, and add it to the model.

    The verdict is "none" (nothing missing can be shown), "effects" (named, with their parameters) or "unknown"
    (something is missing that none of the known effects explains). NEWCAL is a calibration like any other; CAL is not
    changed.

    With --collect the hand that the dataset comes from (--driver, --effect, --hand ...) makes further presses where an
    effect has several names, at most 12, until each has one; NEWCAL/session is the dataset with all presses. An
    interrupted run continues when the same command is given again.
    """
    del cache  # accepted so that commands written for earlier versions still work
    from skincal.calibration import read_calibration, write_calibration
    from skincal.collect import write_plan
    from skincal.collect.rounds import Rounds
    from skincal.dataset import read_dataset
    from skincal.diagnosis.diagnosis import summary
    from skincal.diagnosis.next_presses import PLAN_FILE
    from skincal.diagnosis.workflow import diagnose as find_missing
    from skincal.files import refuse_existing
    from skincal.inference.constants import CONSTANTS
    from skincal.report.cards import verdict_lines
    from skincal.workers.processes import available_cores, import_modules, mapper

    refuse_existing(out, dataset, calibration, force=force, marker="calibration.toml")
    data, cal = read_dataset(dataset), read_calibration(calibration)
    rounds, settled = None, None
    if collect:
        rig = rig_of(driver, seed, effect, hand, driver_option, beyond_limits=beyond_limits)
        rounds = Rounds.of(out, data, rig, partial(press, rig))

    def saved() -> str:
        return (
            ""
            if rounds is None
            else f"{rounds.saved} rounds of presses are saved in {rounds.folder}; {AGAIN}."
        )

    warnings = (*data.warnings, *cal.warnings)
    warn(warnings)
    sessions = CONSTANTS.null_sessions * (5 if thorough else 1)
    if rounds is not None:
        from skincal.diagnosis.adaptive_collection import diagnose_adaptively

        # No bar for the stages: the hand's own is shown while it presses.
        with moving(saved), mapper(workers) as spread:
            settled = diagnose_adaptively(
                data, cal, rounds.press, seed, lambda _: None, sessions, say, mapper=spread
            )
        say(settled.reason)
        data = settled.dataset
    with stage_shown() as show_stage, mapper(workers) as spread, resumable(saved):
        # Workers import while this process begins.
        modules = ["skincal.inference.search", *(["skincal.report.diagnosis"] if report else [])]
        spread(import_modules, [modules] * available_cores())
        if settled is None:
            found = find_missing(data, cal, seed, show_stage, sessions, mapper=spread)
        else:
            found = settled.diagnosis
        show_stage("report")
        now = datetime.now(UTC).replace(microsecond=0)
        provenance = replace(found.calibration.provenance, command=command_line(), seed=seed, time=now)
        found = replace(found, calibration=replace(found.calibration, provenance=provenance))
        content = plain({
            **summary(found),
            **({} if settled is None else {"collected": settled.summary()}),
            "next_presses_plan": None if found.next_plan is None else str(out / PLAN_FILE),
            "calibration": str(out),
            "warnings": [str(problem) for problem in warnings],
        })  # fmt: skip

        def write_extras(folder: Path) -> None:
            from skincal.report.diagnosis import write_diagnosis_report

            write_diagnosis_report(found, data, folder, content, pages=report, mapper=spread)
            if found.next_plan is not None:
                write_plan(found.next_plan, folder / PLAN_FILE)
            if rounds is not None and settled is not None:
                rounds.keep_in(folder, settled.made, settled.rounds)

        write_calibration(found.calibration, out, force=force, beside=write_extras)
        if rounds is not None:
            rounds.done()
    answer(as_json, content, *([] if as_json else verdict_lines(found)), then=calibration_line(out, report))
