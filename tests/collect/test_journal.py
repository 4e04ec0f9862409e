"""The journal: what is kept is whole, another session is refused, half-written files do not count."""

from __future__ import annotations

import errno
from pathlib import Path

import numpy as np
import pytest

from skincal.collect.journal import Journal
from skincal.errors import InputError

KEY = {"plan": "full", "seed": 7}


def open_journal(path: Path, *, restart: bool = False, **changes: object) -> Journal:
    return Journal.open(
        path / ".run.collect", {**KEY, **changes}, {"created": "2026-11-20T12:00:00Z"}, restart=restart
    )


def test_what_is_kept_comes_back(tmp_path: Path):
    journal = open_journal(tmp_path)
    journal.keep_press(3, {"a": np.arange(3.0), "text": np.array("A")})
    journal.keep_rest({"b": np.ones(2)})
    journal.connected({"first": 0, "resumed": False, "shift_s": 0.0})
    again = open_journal(tmp_path)
    assert again.head["created"] == "2026-11-20T12:00:00Z"
    assert list(again.presses()) == [3]
    np.testing.assert_array_equal(again.presses()[3]["a"], np.arange(3.0))
    assert str(again.presses()[3]["text"]) == "A"
    assert len(again.rests()) == 1 and again.connections() == [{"first": 0, "resumed": False, "shift_s": 0.0}]


def test_another_session_is_refused_with_the_choices(tmp_path: Path):
    open_journal(tmp_path).keep_press(0, {"a": np.ones(1)})
    with pytest.raises(InputError) as caught:
        open_journal(tmp_path, seed=8)
    text = str(caught.value)
    assert "seed 8" in text and "seed 7, with 1 finished presses" in text and "--restart" in text
    assert open_journal(tmp_path, restart=True, seed=8).presses() == {}


@pytest.mark.parametrize("content", [b"", b"half a fi", b"PK\x03\x04 no archive"])
def test_a_file_that_is_not_whole_does_not_count(tmp_path: Path, content: bytes):
    journal = open_journal(tmp_path)
    journal.keep_press(0, {"a": np.ones(1)})
    (journal.folder / "press-00001.npz").write_bytes(content)
    (journal.folder / ".press-00002.npz.part").write_bytes(b"cut off")
    assert list(open_journal(tmp_path).presses()) == [0]


def test_a_press_that_cannot_be_read_now_is_not_lost(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    open_journal(tmp_path).keep_press(0, {"a": np.ones(1)})

    def unreachable(path: Path) -> None:
        raise OSError(errno.EIO, "Input/output error", str(path))

    monkeypatch.setattr("skincal.collect.journal.read_arrays", unreachable)
    with pytest.raises(OSError, match="Input/output"):
        open_journal(tmp_path).open_end(2)


def test_a_folder_of_something_else_is_left_alone(tmp_path: Path):
    folder = tmp_path / ".run.collect"
    folder.mkdir()
    (folder / "press-00000.npz").write_bytes(b"mine")
    with pytest.raises(InputError, match="--restart"):
        open_journal(tmp_path)
    assert (folder / "press-00000.npz").read_bytes() == b"mine"


def test_a_folder_in_which_nothing_was_begun_is_used(tmp_path: Path):
    (tmp_path / ".run.collect").mkdir()
    assert open_journal(tmp_path).presses() == {}


def test_a_session_that_recorded_nothing_gives_way_to_another(tmp_path: Path):
    open_journal(tmp_path)
    assert open_journal(tmp_path, seed=8).head["key"]["seed"] == 8
    assert open_journal(tmp_path, seed=8).head["key"]["seed"] == 8


def test_a_full_disk_is_reported_with_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    journal = open_journal(tmp_path)

    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(OSError, match="No space") as caught:
        journal.keep_press(0, {"a": np.ones(1)})
    assert caught.value.filename == str(journal.folder / "press-00000.npz")


def test_removing_leaves_nothing(tmp_path: Path):
    journal = open_journal(tmp_path)
    journal.keep_press(0, {"a": np.ones(1)})
    journal.remove()
    assert not list(tmp_path.iterdir())


def test_a_restart_removes_nothing_that_others_wrote(tmp_path: Path) -> None:
    folder = tmp_path / ".run.collect"
    open_journal(tmp_path)
    (folder / "thesis.txt").write_text("mine")
    for changes in ({"restart": True}, {"seed": 8}):
        with pytest.raises(InputError, match=r"also thesis\.txt"):
            open_journal(tmp_path, **changes)
    open_journal(tmp_path).remove()
    assert (folder / "thesis.txt").read_text() == "mine"


def test_a_folder_next_to_the_journal_is_not_removed(tmp_path: Path) -> None:
    """Its name is that of a journal on its way out."""
    mine = tmp_path / ".run.collect.old"
    mine.mkdir()
    (mine / "thesis.txt").write_text("mine")
    open_journal(tmp_path)
    with pytest.raises(InputError, match=r"also thesis\.txt"):
        open_journal(tmp_path, restart=True)
    open_journal(tmp_path).remove()
    assert (mine / "thesis.txt").read_text() == "mine"
