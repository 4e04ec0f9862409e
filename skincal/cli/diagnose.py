"""``skincal diagnose``: find where simulation and data disagree, and add the missing effects to the model."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable, Generator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from skincal.cli import options
from skincal.cli.collect import Rig
from skincal.cli.interrupt import AGAIN, moving
from skincal.cli.options import command_line, example, option
from skincal.cli.terminal import answer, calibration_line, plain, say, warn
from skincal.errors import input_error

if TYPE_CHECKING:
    from skincal.collect import Plan
    from skincal.dataset import Dataset

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
    from skincal.dataset import read_dataset
    from skincal.diagnosis.next_presses import PLAN_FILE
    from skincal.diagnosis.summary import collected, summary
    from skincal.diagnosis.workflow import diagnose as find_missing
    from skincal.files import refuse_existing
    from skincal.inference.constants import CONSTANTS
    from skincal.report.diagnosis_words import verdict_lines
    from skincal.workers.processes import mapper

    refuse_existing(out, dataset, calibration, force=force, marker="calibration.toml")
    data, cal = read_dataset(dataset), read_calibration(calibration)
    rounds, settled = None, None
    if collect:
        rig = Rig.of(driver, seed, effect, None, hand, driver_option, beyond_limits=beyond_limits)
        rounds = Rounds.of(out, data, rig)
    warnings = (*data.warnings, *cal.warnings)
    warn(warnings)
    sessions = CONSTANTS.null_sessions * (5 if thorough else 1)
    if rounds is not None:
        from skincal.diagnosis.settle import settle

        # No bar for the stages: the hand's own is shown while it presses.
        with moving(rounds.saved), mapper(workers) as spread:
            settled = settle(data, cal, rounds.press, seed, lambda _: None, sessions, say, mapper=spread)
        say(settled.reason)
        data = settled.dataset
    with stage_shown() as show_stage:
        if settled is None:
            with mapper(workers) as spread:
                spread(import_module, ["skincal.inference.search"])  # workers do so while this process begins
                found = find_missing(data, cal, seed, show_stage, sessions, mapper=spread)
        else:
            found = settled.diagnosis
        show_stage("report")
        now = datetime.now(UTC).replace(microsecond=0)
        provenance = replace(found.calibration.provenance, command=command_line(), seed=seed, time=now)
        found = replace(found, calibration=replace(found.calibration, provenance=provenance))
        content = plain({
            **summary(found),
            **({} if settled is None else {"collected": collected(settled)}),
            "next_presses_plan": None if found.next_plan is None else str(out / PLAN_FILE),
            "calibration": str(out),
            "warnings": [str(problem) for problem in warnings],
        })  # fmt: skip

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
    answer(as_json, content, *([] if as_json else verdict_lines(found)), then=calibration_line(out, report))


@contextmanager
def stage_shown() -> Generator[Callable[[str], None]]:
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


SESSION = "session"
"""Folder in the new calibration: the dataset with all presses."""
_KEY = "key.json"
_SEED = re.compile(r"driver sim, seed (\d+)")


@dataclass(frozen=True)
class Rounds:
    """Presses that one run of ``skincal diagnose --collect`` makes.

    Attributes:
        folder: where rounds are saved until the run is over.
        key: what must be equal to continue an interrupted run.
    """

    folder: Path
    key: dict[str, Any]
    rig: Rig

    @classmethod
    def of(cls, out: Path, dataset: Dataset, rig: Rig) -> Rounds:
        """Find what an interrupted run has left.

        Raises:
            InputError: the driver is no hand, a simulated hand is not the one of the dataset, presses of the hand
                cannot join the dataset, or another run was interrupted.
        """
        from skincal.dataset.joined import check_same_rig

        hand, driver, options = rig.hand, rig.name_of_driver, rig.options
        if hand is None:
            fix = "Collect next-presses.toml with it, and diagnose both sessions together."
            raise input_error("--driver", "a hand", f"the stage {driver}", fix)
        raw = replace(hand.meta, sensor=replace(hand.meta.sensor, baseline="raw"))
        check_same_rig(dataset.meta, raw, f"hand {hand.name}")
        if dataset.frames is None:
            fix = "A session of hold means alone cannot be continued."
            raise input_error("--collect", "a dataset with frames", "one without", fix)
        own = _SEED.search(dataset.meta.source)
        if driver == "sim" and own and int(own[1]) != options.get("seed"):
            got, fix = f"--seed {options.get('seed')}", f"Give --seed {own[1]}."
            raise input_error("--driver sim", f"the hand of the dataset, seed {own[1]}", got, fix)
        folder = out.with_name(f".{out.name}.rounds")
        key = {
            "dataset": dataset.sha256, "driver": driver, "seed": rig.seed,
            "options": {k: str(v) for k, v in sorted(options.items())},
        }  # fmt: skip
        own = cls(folder, key, rig)
        own._check_same()
        return own

    def press(self, dataset: Dataset, plan: Plan, number: int) -> Dataset:
        """Make the presses of a round, unless they were made before an interruption; return all presses so far."""
        from skincal.dataset import read_dataset, write_dataset
        from skincal.dataset.joined import GAP_S, joined

        out, whole = self.folder / f"round-{number}", self.folder / f"session-{number}"
        self.folder.mkdir(parents=True, exist_ok=True)
        (self.folder / _KEY).write_text(json.dumps(self.key), encoding="utf-8")
        if not out.exists():
            end_s = 0.0 if dataset.frames is None else float(dataset.frames.time_s[-1])
            driver, hand = self.rig.name_of_driver, self.rig.driver.description.name
            source = f"skincal diagnose --collect: driver {driver}, round {number}, {hand}"
            self.rig.press(plan, out, source, start_s=end_s + GAP_S)
        both = joined(dataset, read_dataset(out))
        source = f"{dataset.meta.source}; round {number} of skincal diagnose --collect"
        write_dataset(replace(both, meta=replace(both.meta, source=source)), whole, force=True)
        return read_dataset(whole)

    def keep_in(self, folder: Path, made: int, rounds: int) -> None:
        """Copy the session with all presses into the folder of the new calibration."""
        if made:
            shutil.copytree(self.folder / f"session-{rounds}", folder / SESSION)

    def done(self) -> None:
        """Remove what was saved for an interruption."""
        shutil.rmtree(self.folder, ignore_errors=True)

    def saved(self) -> str:
        """Return a sentence about the rounds that are saved."""
        count = len(list(self.folder.glob("round-*")))
        return f"{count} rounds of presses are saved in {self.folder}; {AGAIN}."

    def _check_same(self) -> None:
        """Check that an interrupted run, if there is one, is the same one."""
        file, before = self.folder / _KEY, None
        if not file.is_file():
            return
        with suppress(ValueError):
            before = json.loads(file.read_text(encoding="utf-8"))
        if before != json.loads(json.dumps(self.key)):
            fix = f"Give the command that was interrupted, or delete {self.folder} to start over."
            raise input_error(str(self.folder), "rounds of this command", "those of another one", fix)
