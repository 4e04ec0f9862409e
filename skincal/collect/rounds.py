"""Further presses of the hand that a dataset comes from, round by round, kept until they are one session."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from skincal.collect.collection import rig_digest
from skincal.collect.plan import Plan
from skincal.collect.rig import Rig, simulated_seed
from skincal.dataset import Dataset, read_dataset, write_dataset
from skincal.dataset.dataset import GAP_S, check_same_rig, join_sessions
from skincal.errors import input_error
from skincal.files import alone, whole_file

SESSION = "session"
"""Folder in the new calibration: the dataset with all presses."""
_KEY = "key.json"


@dataclass(frozen=True)
class Rounds:
    """Presses that one run of ``skincal diagnose --collect`` makes.

    Attributes:
        folder: where rounds are saved until the run is over.
        key: what must be equal to continue an interrupted run.
        rig: the hand.
        collect: makes the presses of a plan: plan, folder of their dataset, its source, start of the clock [s].
    """

    folder: Path
    key: dict[str, Any]
    rig: Rig
    collect: Callable[[Plan, Path, str, float], object]

    @classmethod
    def of(
        cls, out: Path, dataset: Dataset, rig: Rig, collect: Callable[[Plan, Path, str, float], object]
    ) -> Rounds:
        """Find what an interrupted run has left.

        Raises:
            InputError: the driver is no hand, a simulated hand is not the one of the dataset, presses of the hand
                cannot join the dataset, or another run was interrupted.
        """
        hand, options = rig.hand, rig.options
        if hand is None:
            fix = "Collect next-presses.toml with it, and diagnose both sessions together."
            raise input_error("--driver", "a hand", f"the stage {rig.name}", fix)
        raw = replace(hand.meta, sensor=replace(hand.meta.sensor, baseline="raw"))
        check_same_rig(dataset.meta, raw, f"hand {hand.name}")
        if dataset.frames is None:
            fix = "A session of hold means alone cannot be continued."
            raise input_error("--collect", "a dataset with frames", "one without", fix)
        own = simulated_seed(dataset.meta.source)
        if rig.name == "sim" and own not in (None, options.get("seed")):
            got, fix = f"--seed {options.get('seed')}", f"Give --seed {own}."
            raise input_error("--driver sim", f"the hand of the dataset, seed {own}", got, fix)
        folder = out.with_name(f".{out.name}.rounds")
        key = {"dataset": dataset.sha256, "driver": rig.name, "seed": rig.seed, "options": rig.texts}
        key["hand"] = rig_digest(hand)
        rounds = cls(folder, key, rig, collect)
        rounds._check_same()
        return rounds

    def press(self, dataset: Dataset, plan: Plan, number: int) -> Dataset:
        """Make the presses of a round, unless they were made before an interruption; return all presses so far.

        Raises:
            InputError: another process presses, or another run has begun.
        """
        out, whole = self.folder / f"round-{number}", self.folder / f"session-{number}"
        with alone(self.folder.with_name(f"{self.folder.name}.lock"), self.folder, create=True):
            self._check_same()
            self.folder.mkdir(parents=True, exist_ok=True)
            with whole_file(self.folder / _KEY, force=True) as file:
                file.write_text(json.dumps(self.key), encoding="utf-8")
            if not out.exists():
                end_s = 0.0 if dataset.frames is None else float(dataset.frames.time_s[-1])
                hand = self.rig.driver.description.name
                source = f"skincal diagnose --collect: driver {self.rig.name}, round {number}, {hand}"
                self.collect(plan, out, source, end_s + GAP_S)
            both = join_sessions(dataset, read_dataset(out))
            source = f"{dataset.meta.source}; round {number} of skincal diagnose --collect"
            write_dataset(replace(both, meta=replace(both.meta, source=source)), whole, force=True)
            return read_dataset(whole)

    @property
    def saved(self) -> int:
        """Number of rounds that are saved."""
        return len(list(self.folder.glob("round-*")))

    def keep_in(self, folder: Path, made: int, rounds: int) -> None:
        """Copy the session with all presses into the folder of the new calibration."""
        if made:
            shutil.copytree(self.folder / f"session-{rounds}", folder / SESSION)

    def done(self) -> None:
        """Remove what was saved for an interruption."""
        shutil.rmtree(self.folder, ignore_errors=True)

    def _check_same(self) -> None:
        file, before = self.folder / _KEY, None
        if not file.is_file():
            return
        with suppress(ValueError):
            before = json.loads(file.read_text(encoding="utf-8"))
        if before != json.loads(json.dumps(self.key)):
            fix = f"Give the command that was interrupted, or delete {self.folder} to start over."
            raise input_error(str(self.folder), "rounds of this command", "those of another one", fix)
