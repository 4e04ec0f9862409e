"""Datasets whose files change, or vanish, while they are read: an error that says so."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from skincal.dataset import check_dataset, read_dataset, table_file
from skincal.dataset.folder import add_remarks
from skincal.errors import InputError


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return Path(shutil.copytree("data/paper-like", tmp_path / "data"))


def cut(path: Path) -> None:
    os.truncate(path, path.stat().st_size // 2)


def replaced_by_folder(path: Path) -> None:
    path.unlink()
    path.mkdir()


def replaced_by_pipe(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


def rewritten(path: Path) -> None:
    path.write_bytes(path.read_bytes())
    os.utime(path, ns=(0, 1))


@pytest.mark.parametrize("change", [cut, Path.unlink, replaced_by_folder, replaced_by_pipe, rewritten])
@pytest.mark.parametrize("name", ["dataset.toml", "presses.csv"])
def test_files_that_change_after_they_were_read(
    folder: Path, name: str, change: Callable[[Path], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    remarks = add_remarks

    def meanwhile(*arguments: Any) -> None:
        remarks(*arguments)
        change(folder / name)

    monkeypatch.setattr("skincal.dataset.folder.add_remarks", meanwhile)
    with pytest.raises(InputError, match=r"one that changed while it was read\. Run again"):
        read_dataset(folder)


def test_a_folder_that_vanishes(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("skincal.dataset.folder.add_remarks", lambda *_: shutil.rmtree(folder))
    with pytest.raises(InputError, match="changed while it was read"):
        read_dataset(folder)


@pytest.mark.parametrize("lines", [0, 1, 20])
def test_a_table_that_is_cut_while_it_is_read(
    folder: Path, lines: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    file, read = folder / "presses.csv", table_file.read_rows
    content = file.read_text().splitlines(keepends=True)

    def meanwhile(*arguments: Any) -> Any:
        file.write_text("".join(content[:lines]) + "1,2")
        found = read(*arguments)
        file.write_text("".join(content))
        return found

    monkeypatch.setattr(table_file, "read_rows", meanwhile)
    errors = check_dataset(folder).errors
    assert errors and all("presses.csv" in error.place for error in errors)
