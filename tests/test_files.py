"""Outputs appear whole or not at all."""

from __future__ import annotations

import errno
import os
import socket
from pathlib import Path

import pytest

from skincal.errors import InputError
from skincal.files import check_input, open_input, refuse_existing, whole_file, whole_folder


def test_a_file_appears_at_the_end(tmp_path: Path) -> None:
    path = tmp_path / "out.txt"
    with whole_file(path) as temporary:
        temporary.write_text("done")
        assert not path.exists()
        assert temporary.suffix == ".txt"
    assert path.read_text() == "done"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("error", [OSError, KeyboardInterrupt])
def test_an_error_leaves_the_old_file(tmp_path: Path, error: type[BaseException]) -> None:
    path = tmp_path / "out.txt"
    path.write_text("old")
    with pytest.raises(error), whole_file(path, force=True) as temporary:
        temporary.write_text("half")
        raise error
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_what_exists_is_refused_before_any_work(tmp_path: Path) -> None:
    path = tmp_path / "out.txt"
    path.write_text("old")
    with pytest.raises(InputError, match=r"out\.txt.*--force"), whole_file(path):
        pytest.fail("the work was begun")
    with pytest.raises(InputError, match="a folder"), whole_file(tmp_path, force=True):
        pytest.fail("the work was begun")
    with (
        pytest.raises(InputError, match=r"mkdir -p '.*my folder'"),
        whole_file(tmp_path / "my folder" / "out.txt"),
    ):
        pytest.fail("the work was begun")
    with pytest.raises(InputError, match=r"out\.txt, which is a file"), whole_file(path / "no" / "out.txt"):
        pytest.fail("the work was begun")
    with pytest.raises(InputError, match="a file"), whole_folder(path, force=True, marker="m"):
        pytest.fail("the work was begun")


def test_a_link_to_an_earlier_output_is_refused_before_any_work(tmp_path: Path) -> None:
    """It could not be put in its place at the end."""
    earlier, link = tmp_path / "earlier", tmp_path / "link"
    earlier.mkdir()
    (earlier / "m").touch()
    link.symlink_to(earlier)
    with (
        pytest.raises(InputError, match=r"link.*a link to .*earlier"),
        whole_folder(link, force=True, marker="m"),
    ):
        pytest.fail("the work was begun")
    assert link.is_symlink() and (earlier / "m").is_file()


@pytest.mark.parametrize("named", [True, False])
def test_an_error_names_the_output_that_was_asked_for(tmp_path: Path, named: bool) -> None:
    path = tmp_path / "out.txt"
    with pytest.raises(OSError, match="No space") as raised, whole_file(path) as temporary:
        raise OSError(28, "No space left on device", *([str(temporary)] if named else []))
    assert raised.value.filename == str(path)
    with pytest.raises(OSError, match="No such file") as raised, whole_file(path):
        (tmp_path / "input.txt").read_text()
    assert raised.value.filename == str(tmp_path / "input.txt")


@pytest.mark.parametrize("error", [None, OSError, KeyboardInterrupt])
def test_a_folder_is_replaced_whole(tmp_path: Path, error: type[BaseException] | None) -> None:
    path = tmp_path / "out"
    with whole_folder(path, marker="m") as temporary:
        (temporary / "m").write_text("old")
    try:
        with whole_folder(path, force=True, marker="m") as temporary:
            (temporary / "m").write_text("new")
            if error:
                raise error
    except (OSError, KeyboardInterrupt):
        assert error
    assert (path / "m").read_text() == ("old" if error else "new")
    assert list(tmp_path.iterdir()) == [path]


def test_a_swap_that_fails_brings_the_old_folder_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "out"
    with whole_folder(path, marker="m") as temporary:
        (temporary / "m").write_text("old")
    replace = Path.replace

    def failing(self: Path, target: Path) -> Path:
        if self.suffix == ".part":
            raise OSError(5, "Input/output error", str(self))
        return replace(self, target)

    monkeypatch.setattr(Path, "replace", failing)
    with (
        pytest.raises(OSError, match="Input/output"),
        whole_folder(path, force=True, marker="m") as temporary,
    ):
        (temporary / "m").write_text("new")
    assert (path / "m").read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_an_output_is_as_readable_as_any_file(tmp_path: Path) -> None:
    with whole_folder(tmp_path / "out", marker="m") as temporary:
        (temporary / "m").write_text("x")
    (tmp_path / "usual").mkdir()
    assert (tmp_path / "out").stat().st_mode == (tmp_path / "usual").stat().st_mode


@pytest.mark.parametrize("place", ["", ".", "..", "/"])
def test_a_place_without_a_name_is_refused_even_by_force(
    place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    # An empty folder could be replaced, but not the one that somebody stands in.
    with pytest.raises(InputError, match="a name for the output"):
        refuse_existing(Path(place), force=True, marker="calibration.toml")


def test_a_place_that_cannot_be_written_to_is_refused_before_any_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = os.mkdir

    def no_room(place: str, *rest: int) -> None:
        if Path(place).parent == tmp_path:
            raise PermissionError(errno.EACCES, "Permission denied", place)
        made(place, *rest)

    (tmp_path / "inner").mkdir()
    monkeypatch.setattr(os, "mkdir", no_room)
    with pytest.raises(InputError, match=r"out: expected .* can be written.*; got permission denied"):
        refuse_existing(tmp_path / "out", force=False)
    refuse_existing(tmp_path / "inner" / "out", force=False)
    assert not list((tmp_path / "inner").iterdir())


def test_a_full_disk_is_no_fault_of_the_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device", "a temporary name")

    monkeypatch.setattr(os, "mkdir", full)
    with pytest.raises(OSError, match="No space left") as caught:
        refuse_existing(tmp_path / "out", force=False)
    assert caught.value.filename == str(tmp_path / "out")


@pytest.mark.parametrize("length", [245, 300])
def test_a_name_that_is_too_long_is_refused_before_any_work(tmp_path: Path, length: int) -> None:
    with pytest.raises(InputError, match=r"file name too long.* shorter name"):
        refuse_existing(tmp_path / ("a" * length), force=True, marker="calibration.toml")


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
    with pytest.raises(PermissionError, match="outside of the folder"):
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
