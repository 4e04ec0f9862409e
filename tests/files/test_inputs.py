"""Input files are plain ones, in the folder where they belong."""

from __future__ import annotations

import os
import socket
from pathlib import Path

import pytest

from skincal.files import check_input, open_input


def test_a_plain_file_is_opened(tmp_path: Path) -> None:
    (tmp_path / "data.csv").write_bytes(b"1")
    (tmp_path / "link.csv").symlink_to("data.csv")
    for name in ("data.csv", "link.csv"):
        with open_input(tmp_path / name, within=tmp_path) as file:
            assert file.read() == b"1"
        assert check_input(tmp_path / name) == (tmp_path / "data.csv").resolve()


@pytest.mark.parametrize("place", ["/dev/zero", "pipe", "link-to-device", "socket"])
def test_devices_and_pipes_are_refused(tmp_path: Path, place: str) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link-to-device").symlink_to("/dev/zero")
    with socket.socket(socket.AF_UNIX) as unix:
        unix.bind(str(tmp_path / "socket"))
    with pytest.raises(OSError, match=r"a (pipe|device|socket), not a file"):
        open_input(tmp_path / place)


def test_what_takes_the_place_of_a_checked_file_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "data.csv").touch()
    opened = os.open

    def swapped(path: Path, flags: int) -> int:
        path.unlink()
        os.mkfifo(path)
        return opened(path, flags)

    monkeypatch.setattr(os, "open", swapped)
    with pytest.raises(OSError, match="a pipe, not a file"):
        open_input(tmp_path / "data.csv")


@pytest.mark.parametrize("name", ["../secret", "/etc/hostname", "link", "folder/../../secret", "away/secret"])
def test_files_outside_of_the_folder_are_refused(tmp_path: Path, name: str) -> None:
    folder = tmp_path / "data"
    (folder / "folder").mkdir(parents=True)
    (tmp_path / "secret").write_text("x")
    (folder / "link").symlink_to("../secret")
    (folder / "away").symlink_to("..")
    with pytest.raises(PermissionError, match="outside the folder"):
        open_input(folder / name, within=folder)


def test_a_folder_that_is_reached_by_a_link_is_no_way_out(tmp_path: Path) -> None:
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "x").write_text("1")
    (tmp_path / "link").symlink_to("data")
    with open_input(tmp_path / "link" / "x", within=tmp_path / "link") as file:
        assert file.read() == b"1"


def test_a_folder_is_no_input_file(tmp_path: Path) -> None:
    with pytest.raises(IsADirectoryError):
        open_input(tmp_path)
    with pytest.raises(FileNotFoundError):
        open_input(tmp_path / "none")
    with pytest.raises(OSError, match="null character"):
        open_input(tmp_path / "a\0b", within=tmp_path)
