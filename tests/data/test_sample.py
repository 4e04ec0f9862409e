"""The bundled dataset is the one its README tells of, loads, and can be made again bit for bit."""

from __future__ import annotations

import hashlib
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from skincal.calibrate import fit_problem
from skincal.dataset import check_dataset, dataset_hash, read_dataset
from skincal.fitting.fit_options import FitOptions

ROOT = Path(__file__).parents[2]
SAMPLE = ROOT / "data" / "paper-like"
README = (ROOT / "data" / "README.md").read_text(encoding="utf-8")


def test_hashes_are_those_of_the_readme() -> None:
    assert dataset_hash(SAMPLE) in README
    files = sorted(file for file in SAMPLE.iterdir())
    assert [file.name for file in files] == ["dataset.toml", "presses.csv"]
    for file in files:
        digest = hashlib.sha256(file.read_bytes()).hexdigest()
        assert f"| `{file.name}` | `{digest}` |" in README


def test_loads_without_a_word() -> None:
    check = check_dataset(SAMPLE)
    assert check.errors == ()
    assert check.warnings == ()
    session = read_dataset(SAMPLE)
    assert len(session.presses) == 60
    assert session.presses.counts.max() < 250
    assert 22 <= len(fit_problem(session, FitOptions())) <= 28


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, dict[str, float]]]:
    """The dataset made again as a user does it, and what the script says of it."""
    folder = tmp_path_factory.mktemp("sample") / "paper-like"
    command = [sys.executable, "-m", "data.make_sample", "--out", str(folder)]
    run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    return folder, json.loads(run.stdout)


def test_is_made_again_bit_for_bit(made: tuple[Path, dict[str, dict[str, float]]]) -> None:
    folder, said = made
    for file in SAMPLE.iterdir():
        assert (folder / file.name).read_bytes() == file.read_bytes()
    assert said["sha256"] == dataset_hash(SAMPLE)


def test_truth_is_that_of_the_readme(made: tuple[Path, dict[str, dict[str, float]]]) -> None:
    truth, told = made[1]["truth"], made[1]["truth_as_the_positions_tell_it"]
    rows = dict(re.findall(r"^\| (y|beta|alpha|E|S) \| (.*) \|$", README, flags=re.MULTILINE))
    numbers = {
        name: [float(n) for n in re.findall(r"-?\d+\.\d+", row.replace("−", "-"))]
        for name, row in rows.items()
    }
    assert numbers == {
        "y": [round(truth["y_m"] * 1e3, 3), round(told["y_m"] * 1e3, 3)],
        "beta": [round(truth["beta_deg"], 3), round(told["beta_deg"], 3)],
        "alpha": [round(truth["alpha_deg"], 3)],
        "E": [round(truth["elasticity_pa_per_m"] / 1e6, 1)],
        "S": [round(truth["scale_per_n"], 2)],
    }
