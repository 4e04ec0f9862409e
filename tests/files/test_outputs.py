"""Outputs appear whole or not at all."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from skincal.errors import InputError
from skincal.files import refuse_existing, whole_file, whole_folder


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
    """A link could not be replaced at the end."""
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


def test_an_unwritable_place_is_refused_before_any_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = os.mkdir

    def no_room(place: str, *rest: int) -> None:
        if Path(place).parent == tmp_path:
            raise PermissionError(errno.EACCES, "Permission denied", place)
        made(place, *rest)

    (tmp_path / "inner").mkdir()
    monkeypatch.setattr(os, "mkdir", no_room)
    with pytest.raises(InputError, match=r"out: expected a writable place .*; got permission denied"):
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
