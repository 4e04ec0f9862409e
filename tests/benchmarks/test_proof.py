"""The proof's command: what it does, what it keeps, and what its table says."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from calibrations import make_calibration

pytest.importorskip("stable_baselines3")

from benchmarks import proof
from skincal.calibration import Effect, write_calibration
from skincal.ranges import Ranges, read_ranges
from skincal.train import policy_path
from skincal.train.evaluate import Trial
from skincal.train.scores import Runs

ERRORS_M = {"before": 0.9e-3, "a": 0.8e-3, "b": 0.6e-3, "c": 0.5e-3}


class Machine:
    """Stands for skincal's commands and for the hands: notes what is done, and how often."""

    def __init__(self) -> None:
        self.commands: list[list[str]] = []
        self.runs = 0
        self.variant: dict[str, str] = {}

    def run(self, *arguments: str | Path) -> None:
        texts = [str(one) for one in arguments]
        self.commands.append(texts)
        out = Path(texts[texts.index("--out") + 1])
        if texts[0] == "collect":
            out.mkdir()
            model = {"y_m": 0.0235, "beta_deg": 2.0, "alpha_deg": -3.0}
            model |= {"elasticity_pa_per_m": 5e8, "scale_per_n": 68.0}
            spread = {"name": "spread", "parameters": {"width_m": 0.001, "tail": 0.0}}
            truth = {"model": model, "effects": [spread]}
            Path(texts[texts.index("--truth") + 1]).write_text(json.dumps(truth))
        elif texts[0] in ("fit", "diagnose"):
            found = (Effect("spread", {"width_m": 0.0012, "tail": 0.0}),) if texts[0] == "diagnose" else ()
            write_calibration(make_calibration(effects=found), out)
        else:
            out.mkdir()
            content = policy_path("marble-tactile-1").read_bytes()
            (out / "policy.onnx").write_bytes(content)

    def reference_runs(self, policy: Any, trial: Trial, *, ranges: Ranges, engine: str) -> Runs:
        assert ranges["skin.effects.spread.width_m"].value == 0.001 and engine in ("pybullet", "mujoco")
        self.runs += 1
        name = Path(policy.file).parent.name.removeprefix("policy-")
        error = ERRORS_M.get(name, ERRORS_M["before"])
        shape = (trial.episodes, trial.steps)
        jitter = 1e-5 * np.random.default_rng(trial.seed).normal(size=shape)
        return replace(Runs.empty(*shape, 10.0), error_m=error + jitter)


@pytest.fixture
def machine(monkeypatch: pytest.MonkeyPatch) -> Machine:
    made = Machine()
    monkeypatch.setattr(proof, "run", made.run)
    monkeypatch.setattr(proof, "reference_runs", made.reference_runs)
    return made


@pytest.fixture
def prove(tmp_path: Path) -> Callable[..., None]:
    def go(*more: str) -> None:
        given = ("--effects", "spread=2", "--seeds", "1", "--runs", "10", "--steps", "1000", *more)
        proof.main(["--out", str(tmp_path / "proof"), "--from", "marble-tactile-1", *given])

    return go


def test_nothing_is_done_twice(machine: Machine, prove: Callable[..., None], tmp_path: Path) -> None:
    prove()
    verbs = [command[0] for command in machine.commands]
    assert verbs == ["collect", "fit", "diagnose", "train", "train", "train"]
    assert machine.runs == 4 * 2 * 2
    prove()
    assert len(machine.commands) == 6 and machine.runs == 16
    prove("--runs", "15")
    assert len(machine.commands) == 6 and machine.runs == 16 + 4 * 2
    ranges = {v: read_ranges(tmp_path / "proof" / "spread-2-1" / f"ranges-{v}.toml") for v in "abc"}
    assert "skin.effects.spread.width_m" not in ranges["a"]
    assert ranges["b"]["skin.effects.spread.width_m"].source == "calibrated"
    assert ranges["c"]["skin.effects.spread.width_m"].value == 0.001


def test_the_table_says_what_is_lost_and_recovered(
    machine: Machine, prove: Callable[..., None], capsys: pytest.CaptureFixture[str]
) -> None:
    del machine
    prove()
    row = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("| `spread=2`"))
    cells = [cell.strip() for cell in row.strip("|").split("|")]
    assert cells[0] == "`spread=2`, hand 1 (named: spread)"
    assert [cell.split(" ")[0] for cell in cells[2:6]] == ["0.90", "0.80", "0.60", "0.50"]
    assert cells[6].startswith("+0.30") and cells[7] == "67%"
