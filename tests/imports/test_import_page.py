"""The worked examples of the page on imports run, and give what they promise."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

from skincal.dataset import read_dataset
from skincal.dataset.schema import keys_of
from skincal.imports.mapping_file import CutRules
from skincal.imports.targets import FACTORS

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "import.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The folder in which every example of the page has run, and what the commands printed."""
    folder = tmp_path_factory.mktemp("page")
    (folder / "data").symlink_to(ROOT / "data")
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    printed = ""
    for kind, content in re.findall(r"```\{(run-python|console)\}\n(.*?)```", PAGE, re.S):
        status = re.match(r":status: (\d)\n", content)
        expected = int(status[1]) if status else 0
        lines = content[status.end() :] if status else content
        for line in [lines] if kind == "run-python" else lines.strip().splitlines():
            command = [sys.executable, "-c", line] if kind == "run-python" else ["bash", "-c", line]
            done = subprocess.run(
                command,
                cwd=folder,
                env=os.environ | {"PATH": path},
                capture_output=True,
                text=True,
                check=False,
            )
            assert done.returncode == expected, line + done.stdout + done.stderr
            printed += done.stdout + done.stderr
    return folder, printed


@pytest.mark.slow
def test_table_of_presses_comes_back(page: tuple[Path, str]):
    found = read_dataset(page[0] / "dataset").presses
    ours = pd.read_csv(ROOT / "data" / "paper-like" / "presses.csv")
    assert found.force_n == pytest.approx(ours.force_n, rel=1e-5)
    assert found.position_m[:, 1] == pytest.approx(ours.y_m, rel=1e-5)


@pytest.mark.slow
def test_series_gives_every_press(page: tuple[Path, str]):
    ours = pd.read_csv(ROOT / "data" / "paper-like" / "presses.csv")
    found = read_dataset(page[0] / "session")
    assert len(found.presses) == 60
    assert found.presses.force_n == pytest.approx(ours.force_n, rel=0.01)


@pytest.mark.slow
def test_bag_gives_its_presses(page: tuple[Path, str]):
    ours = pd.read_csv(ROOT / "data" / "paper-like" / "presses.csv").head(5)
    found = read_dataset(page[0] / "recorded")
    assert found.presses.force_n == pytest.approx(ours.force_n, rel=0.01)


@pytest.mark.slow
def test_refusals_name_the_place_and_leave_nothing(page: tuple[Path, str]):
    folder, printed = page
    assert not (folder / "other").exists()
    assert 'expected a column "F [mN]"' in printed
    assert '[columns.position], unit "m"' in printed


def test_page_names_every_unit_and_every_rule():
    units = [name for kind, names in FACTORS.items() if kind != "number" for name in names]
    assert [
        name for name in (*units, *keys_of(CutRules)) if f"`{name}`" not in PAGE and f"`{name} " not in PAGE
    ] == []
