"""Names that the system's encoding does not have: files are read and written, and messages name them somehow."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from calibrations import make_calibration
from chambers import Chamber

from skincal.calibration import write_calibration

ASCII = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}


@pytest.fixture
def place(tmp_path: Path) -> Path:
    folder = tmp_path / "папка"
    shutil.copytree("data/paper-like", folder / "данные")
    write_calibration(make_calibration(rows=20), folder / "калибровка")
    return folder


def skincal(place: Path, *words: str) -> subprocess.CompletedProcess[bytes]:
    command = [sys.executable, "-m", "skincal", *words]
    return subprocess.run(command, cwd=place, env={**os.environ, **ASCII}, capture_output=True, timeout=100)


@pytest.mark.parametrize(
    "words",
    [
        "dataset check данные",
        "dataset show данные --out рисунок.png",
        "predict калибровка данные --out предсказание",
        "export-dr калибровка --out диапазоны.toml",
        "export-dr калибровка --out диапазоны.yaml",
    ],
)
def test_verbs_take_any_name(place: Path, words: str) -> None:
    done = skincal(place, *words.split(), "--json")
    assert done.returncode == 0, done.stderr
    json.loads(done.stdout)["dataset" if "данные" in words else "ranges"].encode()
    if "--out" in words:
        assert (place / words.split()[-1]).exists()


def test_a_fit_writes_the_command_with_its_names(place: Path) -> None:
    Chamber.plain().write(place / "камера", frames=False)
    done = skincal(place, "fit", "камера", "--out", "новая")
    assert done.returncode == 0, done.stderr
    content = tomllib.loads((place / "новая" / "calibration.toml").read_text(encoding="utf-8"))
    assert content["provenance"]["command"].replace("'", "") == "skincal fit камера --out новая"
    assert "камера" in (place / "новая" / "report.html").read_text(encoding="utf-8")


def test_an_error_names_the_file(place: Path) -> None:
    done = skincal(place, "dataset", "check", "нет")
    assert done.returncode == 2
    assert "нет: expected" in done.stderr.decode()
