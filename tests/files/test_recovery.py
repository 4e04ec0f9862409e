"""Leftovers of a killed process are removed or restored with a message; files in use stay."""

from __future__ import annotations

import logging
import os
from pathlib import Path

import pytest
from killing import end_of

from skincal.files import outputs, recover, whole_file, whole_folder
from skincal.files.manifest import NAME

ABANDONED = ".out.abcd_123.part"


def output(path: Path, text: str) -> None:
    with whole_folder(path, marker="eval.json", force=True) as folder:
        (folder / "eval.json").write_text(text)


def listed(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_leftovers_are_swept_and_reported(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    (tmp_path / ABANDONED / "deep").mkdir(parents=True)
    (tmp_path / ABANDONED / NAME).touch()
    others = [
        ".out.v2.abcd_123.part",
        ".out.notes.part",
        ".out.fit",
        "out.abcd_123.part",
        ".other.abcd_123.part",
    ]
    for other in others:
        (tmp_path / other).mkdir()
    output(tmp_path / "out", "new")
    assert listed(tmp_path) == sorted([*others, "out"])
    assert f"removed leftovers of interrupted runs: {ABANDONED}" in caplog.text


def test_what_another_process_writes_is_left_alone(tmp_path: Path) -> None:
    with whole_folder(tmp_path / "out", marker="eval.json") as folder:
        (folder / "eval.json").write_text("first")
        output(tmp_path / "out.other", "x")
        child = os.fork()
        if not child:
            try:
                output(tmp_path / "out", "second")  # another process with the same output
            finally:
                os._exit(0)
        end_of(child)
        assert (folder / "eval.json").read_text() == "first"
        (tmp_path / "out").rename(tmp_path / "second")
    assert (tmp_path / "out" / "eval.json").read_text() == "first" and (
        tmp_path / "second" / "eval.json"
    ).read_text() == "second"


@pytest.mark.parametrize("listed_old", [True, False])
def test_a_kill_between_two_moves_is_mended(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, listed_old: bool
) -> None:
    """The kernel here cannot exchange two names."""
    output(tmp_path / "out", "old")
    if not listed_old:
        (tmp_path / "out" / NAME).unlink()
    child = os.fork()
    if not child:
        monkeypatch.setattr(outputs, "_renameat2", lambda *_: False)
        rename = Path.rename

        def killed(self: Path, target: Path) -> Path:
            rename(self, target)
            os._exit(9)

        monkeypatch.setattr(Path, "rename", killed)
        try:
            output(tmp_path / "out", "new")
        finally:
            os._exit(0)
    end_of(child)
    assert not (tmp_path / "out").exists() and len(listed(tmp_path)) == 2
    recover(tmp_path / "out")
    assert listed(tmp_path) == ["out"] and (tmp_path / "out" / "eval.json").read_text() == "old"
    assert "an interrupted run had moved it away" in caplog.text


def test_a_move_that_fails_brings_the_old_folder_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    output(tmp_path / "out", "old")
    rename = Path.rename

    def failing(self: Path, target: Path) -> Path:
        if self.suffix == ".part":
            raise OSError(5, "Input/output error", str(self))
        return rename(self, target)

    monkeypatch.setattr(outputs, "_renameat2", lambda *_: False)
    monkeypatch.setattr(Path, "rename", failing)
    with pytest.raises(OSError, match="Input/output"):
        output(tmp_path / "out", "new")
    assert (tmp_path / "out" / "eval.json").read_text() == "old" and listed(tmp_path) == ["out"]


@pytest.mark.parametrize("kind", ["folder", "file"])
def test_all_is_on_the_disk_before_it_is_in_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    order: list[str] = []
    fsync, move = os.fsync, outputs._renameat2

    def synced(descriptor: int) -> None:
        order.append(Path(f"/proc/self/fd/{descriptor}").readlink().name)
        fsync(descriptor)

    def moved(*arguments: object) -> bool:
        order.append("move")
        return move(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(os, "fsync", synced)
    monkeypatch.setattr(outputs, "_renameat2", moved)
    if kind == "folder":
        output(tmp_path / "out", "new")
        assert {"eval.json", NAME} <= set(order[: order.index("move")]) and order[-1] == tmp_path.name
    else:
        with whole_file(tmp_path / "out") as file:
            file.write_text("new")
        assert order == ["out", "move", tmp_path.name]


def test_the_command_line_tells(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from calibrations import make_calibration

    from skincal.calibration import write_calibration
    from skincal.cli.main import main

    write_calibration(make_calibration(), tmp_path / "cal")
    (tmp_path / ".ranges.toml.abcd_123.part").mkdir()
    try:
        with pytest.raises(SystemExit):
            main(["export-dr", str(tmp_path / "cal"), "--out", str(tmp_path / "ranges.toml")])
    finally:
        logging.getLogger("skincal").handlers.clear()
    assert "skincal: " in (err := capsys.readouterr().err) and "removed leftovers of interrupted runs" in err
    assert listed(tmp_path) == ["cal", "ranges.toml"]


def test_a_link_in_the_place_of_a_leftover_is_not_followed(tmp_path: Path) -> None:
    """Neither is a file made in the folder where it leads, nor does it become the output."""
    (tmp_path / "thesis").mkdir()
    for name in (ABANDONED, ".out.abcd_123.old"):
        (tmp_path / name).symlink_to(tmp_path / "thesis")
    recover(tmp_path / "out")
    assert listed(tmp_path / "thesis") == []
    assert listed(tmp_path) == sorted([ABANDONED, ".out.abcd_123.old", "thesis"])
