"""``skincal dataset check`` and ``show`` as a user runs them."""

from __future__ import annotations

import io
import json
import os
from pathlib import Path

import pandas as pd
import pytest
from commands import Run, RunJson

from skincal.dataset import dataset_hash
from skincal.report.style import new_figure, save


def break_force(folder: Path) -> None:
    path = folder / "presses.csv"
    lines = path.read_text().splitlines()
    cells = lines[3].split(",")
    cells[4] = "NaN"
    path.write_text("\n".join([*lines[:3], ",".join(cells), *lines[4:]]) + "\n")


def test_check_with_doubts_does_not_say_good(run: Run, folder: Path) -> None:
    table = pd.read_csv(folder / "presses.csv")
    table.force_n /= 9.80665e-3
    table.to_csv(folder / "presses.csv", index=False)
    (folder / "frames.csv").unlink()
    code, out, err = run("dataset", "check", folder)
    assert code == 0 and "grams-force" in err
    assert out.startswith(f"{folder}: doubtful, see the warnings, 12 presses")


def test_check_of_good_data(run: Run, folder: Path) -> None:
    status, out, err = run("dataset", "check", folder)
    assert status == 0
    assert out == f"{folder}: good, 12 presses, 96 frames\n"
    assert err.startswith(f"skincal: warning: {folder}/dataset.toml, created")


def test_check_of_bad_data(run: Run, folder: Path) -> None:
    break_force(folder)
    status, out, err = run("dataset", "check", folder)
    assert status == 2
    assert out == ""
    assert f"{folder}/presses.csv, column force_n, row 3 (line 4): expected a number; got nan" in err
    assert "Traceback" not in err


def test_check_names_everything_however_much(run: Run, folder: Path) -> None:
    presses = pd.read_csv(folder / "presses.csv").astype(object)
    for column in presses.columns:
        if column.startswith("taxel_"):
            presses.loc[0, column] = "much"
    presses.to_csv(folder / "presses.csv", index=False)
    status, _, err = run("dataset", "check", folder)
    assert status == 2 and "--debug" not in err
    assert sum("got 'much'" in line for line in err.splitlines()) == 16


def test_check_as_json(run: Run, run_json: RunJson, folder: Path) -> None:
    assert run_json("dataset", "check", folder)["ok"] is True
    break_force(folder)
    status, out, _ = run("dataset", "check", folder, "--json")
    assert status == 2
    found = json.loads(out)
    assert found["ok"] is False
    assert found["errors"] == [
        {
            "place": f"{folder}/presses.csv, column force_n, row 3 (line 4)",
            "expected": "a number",
            "got": "nan",
            "fix": "Give the number, or leave the row out.",
        }
    ]


def test_plate_on_a_finger_is_no_uniform_pressure(run: Run, run_json: RunJson, folder: Path) -> None:
    assert run_json("dataset", "check", folder)["notes"] == []
    path = folder / "dataset.toml"
    sphere = 'kind = "sphere"\nradius_m = 0.006'
    assert sphere in path.read_text()
    path.write_text(path.read_text().replace(sphere, 'kind = "flat"\nradius_m = 0.05'))
    status, out, err = run("dataset", "check", folder)
    assert status == 0
    assert "good" in out
    assert "uniform pressure" not in err


def test_show(run: Run, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Texts and names of any letters are shown as they are; brackets in them are no markup."""
    monkeypatch.setenv("COLUMNS", "400")
    path = folder / "dataset.toml"
    path.write_text(path.read_text().replace("made for a test", "rig [bold] 2 [/nothing]"))
    named, picture = folder.rename(tmp_path / "指尖 [b] [red] 'x' $a$"), tmp_path / "picture.png"
    status, out, err = run("dataset", "show", named, "--out", picture)
    assert status == 0
    assert "4 x 4 taxels on a cylinder of radius 11.5 mm" in out
    assert "96: " in out
    assert named.name in out and "rig [bold] 2 [/nothing]" in out
    assert f"picture: {picture}" in err and "missing" not in err
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_show_as_json_replaces_its_picture(run_json: RunJson, folder: Path, tmp_path: Path) -> None:
    save(new_figure(2, 1), tmp_path / "p.svg")
    before = (tmp_path / "p.svg").read_bytes()
    shown = run_json("dataset", "show", folder, "--out", tmp_path / "p.svg", "--threshold", 20, "--force")
    assert len((tmp_path / "p.svg").read_bytes()) > 2 * len(before)
    assert shown["presses"] == 12
    assert shown["sha256"] == dataset_hash(folder)
    assert shown["active_taxels"]["threshold_counts"] == 20
    assert sum(shown["active_taxels"]["presses_by_number"]) == 12
    assert shown["picture"] == str(tmp_path / "p.svg")


def test_show_of_bad_data_draws_nothing(run: Run, folder: Path, tmp_path: Path) -> None:
    break_force(folder)
    status, out, err = run("dataset", "show", folder, "--out", tmp_path / "picture.png", "--json")
    assert (status, out) == (2, "")
    assert "row 3" in err
    assert not (tmp_path / "picture.png").exists()


def test_show_refuses_other_kinds_of_picture(run: Run, folder: Path, tmp_path: Path) -> None:
    status, _, err = run("dataset", "show", folder, "--out", tmp_path / "picture.jpg")
    assert status == 2
    assert ".png" in err


def test_a_full_disk(run: Run, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(figure: object, path: Path) -> None:
        path.write_bytes(b"half")
        raise OSError(28, "No space left on device", str(path))

    monkeypatch.setattr("skincal.report.style.save", full)
    status, out, err = run("dataset", "show", folder, "--out", tmp_path / "picture.png")
    assert (status, out) == (1, "")
    assert f"{tmp_path / 'picture.png'}: No space left on device" in err
    assert "Free some space" in err
    assert [path.name for path in tmp_path.iterdir()] == ["session"]


def test_letters_that_a_terminal_lacks_are_no_fault(
    run: Run, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without ``--out`` the picture lies in the working folder."""
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    monkeypatch.setenv("COLUMNS", "400")
    shown = io.BytesIO()
    monkeypatch.setattr("sys.stdout", io.TextIOWrapper(shown, encoding="ascii", write_through=True))
    status, _, _ = run("dataset", "show", folder.rename(tmp_path / "指尖"))
    assert status == 0
    assert rb"\u6307\u5c16" in shown.getvalue()
    assert [path.name for path in (tmp_path / "work").iterdir()] == ["指尖.png"]


def test_a_name_that_is_no_text_is_shown_somehow(run: Run, folder: Path, tmp_path: Path) -> None:
    named = folder.rename(tmp_path / os.fsdecode(b"a\xff\xfe"))
    status, out, _ = run("dataset", "check", named)
    assert status == 0
    assert "good, 12 presses" in out
