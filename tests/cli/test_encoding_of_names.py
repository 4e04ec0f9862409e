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


def python(place: Path, *arguments: str) -> subprocess.CompletedProcess[bytes]:
    command = [sys.executable, *arguments]
    return subprocess.run(command, cwd=place, env={**os.environ, **ASCII}, capture_output=True, timeout=100)


VERBS = {
    "dataset check данные": "dataset",
    "dataset show данные --out рисунок.png": "dataset",
    "predict калибровка данные --out предсказание": "dataset",
    "export-dr калибровка --out диапазоны.toml": "ranges",
    "export-dr калибровка --out диапазоны.yaml": "ranges",
    "fit камера --out новая": "calibration",
    "dataset check нет": "",
}
"""Command lines, and what of their answers is a path."""
RUN_ALL = """
import sys
from skincal.cli.main import main
for words in sys.argv[1:]:
    sys.argv[1:] = [*words.split(), "--json"]
    try:
        main()
    except SystemExit as ended:
        print(ended.code, file=sys.stderr)
"""


def test_verbs_take_any_name(place: Path) -> None:
    """One after another in a process: each begins with its own command line."""
    Chamber.plain().write(place / "камера", frames=False)
    command = [sys.executable, "-c", RUN_ALL, *VERBS]
    done = subprocess.run(command, cwd=place, env={**os.environ, **ASCII}, capture_output=True, timeout=100)
    statuses = [line for line in done.stderr.decode().splitlines() if line.isdecimal()]
    assert statuses == ["0"] * 6 + ["2"], done.stderr
    for (words, path), line in zip(VERBS.items(), done.stdout.decode().splitlines(), strict=True):
        told = json.loads(line)
        if not path:
            assert told["errors"][0]["place"] == "нет"
            continue
        told[path].encode()
        if "--out" in words:
            assert (place / words.split()[-1]).exists()
    assert "нет: expected" in done.stderr.decode()
    content = tomllib.loads((place / "новая" / "calibration.toml").read_text(encoding="utf-8"))
    assert content["provenance"]["command"].replace("'", "") == "skincal fit камера --out новая --json"
    assert "камера" in (place / "новая" / "report.html").read_text(encoding="utf-8")
