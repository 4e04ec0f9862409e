"""The demonstration replaces an earlier one and nothing else."""

from __future__ import annotations

from pathlib import Path

import pytest

from skincal.cli import demo
from skincal.cli.demo import MARKER, make_room
from skincal.cli.main import main
from skincal.errors import InputError
from skincal.files.manifest import NAME, write_manifest
from skincal.sample import NAMES, sample_path


def test_only_an_earlier_demonstration_is_replaced(tmp_path: Path) -> None:
    out = tmp_path / "demo"
    make_room(out)
    (out / "run").mkdir()
    (out / "run" / "presses.csv").touch()
    write_manifest(out)
    make_room(out)
    assert {path.name for path in out.iterdir()} == {MARKER, NAME}
    (out / "thesis.tex").touch()
    with pytest.raises(InputError, match=r"thesis\.tex"):
        make_room(out)
    assert (out / "thesis.tex").is_file()


def test_session_is_no_demonstration(folder: Path) -> None:
    with pytest.raises(InputError, match=MARKER):
        make_room(folder)
    assert (folder / "presses.csv").is_file()


def test_samples_are_there() -> None:
    assert all(sample_path(name).exists() for name in NAMES)


def test_a_verb_that_fails_ends_the_demonstration_with_its_status(
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
