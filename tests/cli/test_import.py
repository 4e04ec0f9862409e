"""``skincal import csv`` and ``rosbag`` as a user runs them."""

from __future__ import annotations

from pathlib import Path

import pytest
from commands import Run, RunJson

from skincal.dataset import read_dataset
from tests.imports.foreign import PRESS_ROWS, mapping, press_table, write_mapping, write_press_table

BUNDLED = Path(__file__).parents[2] / "data" / "paper-like"


@pytest.fixture
def source(tmp_path: Path) -> tuple[Path, Path]:
    table = press_table(read_dataset(BUNDLED))
    table.loc[2, "Fz"] = None
    content = mapping(PRESS_ROWS, csv={"drop_incomplete": True}, columns={"pose": {"value": "A"}})
    return write_mapping(tmp_path, content), write_press_table(tmp_path / "p.csv", table)


def test_csv_says_what_was_read_and_left_out(run: Run, source: tuple[Path, Path], tmp_path: Path):
    status, out, err = run("import", "csv", *source, "--out", tmp_path / "d")
    assert status == 0
    assert out == f"{tmp_path / 'd'}: 59 presses\n"
    assert "read 60 rows of p.csv\n" in err
    assert "left out 1 row: no value in a required column (force_n)\n" in err
    assert run("dataset", "check", tmp_path / "d")[0] == 0


def test_csv_as_json(run_json: RunJson, source: tuple[Path, Path], tmp_path: Path):
    assert run_json("import", "csv", *source, "--out", tmp_path / "d") == {
        "dataset": str(tmp_path / "d"),
        "presses": 59,
        "frames": 0,
        "read": [{"file": "p.csv", "rows": 60}],
        "dropped": [{"count": 1, "what": "row", "why": "no value in a required column (force_n)"}],
        "assumed": [],
        "warnings": [],
        "notes": [],
        "clocks": [],
        "picture": None,
        "findings": [],
    }


def test_wrong_input_is_status_two_and_leaves_nothing(run: Run, source: tuple[Path, Path], tmp_path: Path):
    source[1].write_text(source[1].read_text().replace("Fz", "Fn"))
    status, out, err = run("import", "csv", *source, "--out", tmp_path / "d", "--json")
    assert (status, out) == (2, "")
    assert 'p.csv: expected a column "Fz"' in err and "Traceback" not in err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["map.toml", "p.csv"]


@pytest.mark.parametrize("kind", ["csv", "rosbag"])
def test_template(run: Run, kind: str):
    status, out, err = run("import", kind, "--template")
    assert (status, err) == (0, "")
    assert out.startswith("# How the") and 'format = "skincal-import/1"' in out


def test_topics_of_what_is_no_bag(run: Run, tmp_path: Path):
    status, out, err = run("import", "rosbag", "--topics", tmp_path / "s.bag")
    assert (status, out) == (2, "")
    assert "s.bag" in err and "Traceback" not in err
