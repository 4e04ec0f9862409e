"""The demonstration replaces an earlier one and nothing else."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from skincal.cli import demo
from skincal.cli.demo import MARKER, make_room
from skincal.cli.main import main
from skincal.collect import journal_folder
from skincal.collect.journal import Journal
from skincal.errors import InputError
from skincal.files import alone, whole_folder
from skincal.files.manifest import NAME


def left_behind(out: Path) -> Path:
    """Return a demonstration that was killed while it collected and fitted its second session."""
    make_room(out)
    with whole_folder(out / "run", marker="dataset.toml") as run:
        (run / "dataset.toml").touch()
    (out / "truth.json").touch()
    (out / ".cal.abcdefgh.part").mkdir()
    Journal.open(journal_folder(out / "gap"), {}, {"created": "2026-01-01"}, restart=False)
    (out / ".gap-cal.fit" / ".turn-001.npz.abcdefgh.part").mkdir(parents=True)
    (out / ".gap-cal.fit" / "turn-000.npz").touch()
    return out


def test_an_earlier_demonstration_is_replaced_however_it_ended(tmp_path: Path) -> None:
    out = left_behind(tmp_path / "demo")
    make_room(out)
    assert {path.name for path in out.iterdir()} == {MARKER, NAME}


@pytest.mark.parametrize(
    "name",
    [
        "thesis.tex",
        "run/notes.txt",
        "cal/mine.toml",
        ".gap.collect/x.csv",
        ".mine.collect/press-1.npz",
        ".gap-cal.fit/x.csv",
    ],
)
def test_a_demonstration_with_work_of_others_stays(tmp_path: Path, name: str) -> None:
    out = left_behind(tmp_path / "demo")
    (out / name).parent.mkdir(exist_ok=True)
    (out / name).touch()
    with pytest.raises(InputError, match=re.escape(Path(name).parts[0])):
        make_room(out)
    assert (out / name).is_file()
    assert (out / "truth.json").is_file()


def test_a_demonstration_at_work_stays(tmp_path: Path) -> None:
    out = left_behind(tmp_path / "demo")
    with alone(out / MARKER, out), pytest.raises(InputError, match="another process at work"):
        make_room(out)
    assert (out / "run" / "dataset.toml").is_file()


def test_a_verb_that_outlives_its_demonstration_is_at_work(tmp_path: Path) -> None:
    out, verb = tmp_path / "demo", tmp_path / "verb"
    verb.write_text("#!/bin/sh\necho $$\nexec sleep 100\n")
    verb.chmod(0o700)
    code = "import sys; from skincal.cli import demo; sys.executable, out = sys.argv[1:]; demo.demo(demo.Path(out))"
    command = [sys.executable, "-c", code, verb, out]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as killed:
        assert killed.stdout is not None
        orphan = next(int(line) for line in killed.stdout if line.strip().isdecimal())
        killed.kill()
    try:
        with pytest.raises(InputError, match="another process at work"):
            make_room(out)
    finally:
        os.kill(orphan, signal.SIGKILL)


def test_session_is_no_demonstration(folder: Path) -> None:
    with pytest.raises(InputError, match=MARKER):
        make_room(folder)
    assert (folder / "presses.csv").is_file()


def test_samples_are_there() -> None:
    assert all(demo.sample_path(name).exists() for name in ("paper-like", "short-plan.toml"))


def test_failed_verb_ends_the_demonstration(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def ends(*arguments: str, quiet: bool = False) -> str:
        return inner("fit", str(tmp_path / "nothing"), "--out", str(tmp_path / "cal"))

    inner = demo.skincal
    monkeypatch.setattr(demo, "skincal", ends)
    with pytest.raises(SystemExit) as ended:
        main(["demo", "--out", str(tmp_path / "demo")])
    assert ended.value.code == InputError.exit_status
    errors = capfd.readouterr().err
    assert "nothing" in errors
    assert "internal error" not in errors
