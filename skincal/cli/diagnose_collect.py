"""``skincal diagnose --collect``: the hand that makes the presses, and their session until the end."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from skincal.cli.collect import Rig
from skincal.cli.interrupt import AGAIN
from skincal.errors import input_error

if TYPE_CHECKING:
    from skincal.collect import Plan
    from skincal.dataset import Dataset

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
        rig: the hand.
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
        _check_same(folder, key)
        return cls(folder, key, rig)

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


def _check_same(folder: Path, key: dict[str, Any]) -> None:
    """Check that an interrupted run, if there is one, is the same one."""
    file = folder / _KEY
    if not file.is_file():
        return
    try:
        before = json.loads(file.read_text(encoding="utf-8"))
    except ValueError:
        before = None
    if before != json.loads(json.dumps(key)):
        fix = f"Give the command that was interrupted, or delete {folder} to start over."
        raise input_error(str(folder), "rounds of this command", "those of another one", fix)
