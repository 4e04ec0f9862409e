"""The demonstration replaces an earlier one and nothing else."""

from __future__ import annotations

from pathlib import Path

import pytest

from skincal.cli.demo import MARKER, make_room
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
